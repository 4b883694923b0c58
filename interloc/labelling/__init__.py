"""Labels of scans: by a segmentation network (RangeNet++ and its family), or by geometry and the driven track."""
