"""Reading drives: layouts, poses, labels, georeference."""
