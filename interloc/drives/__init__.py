"""Reading of drives: layouts, poses, labels, georeference, and the checks of all of them."""
