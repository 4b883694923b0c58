"""Reduced drives: the ground points of the scans that the method looks at, and nothing else of the scans.

The method needs the road points of keyframes, and the sidewalk, parking and other ground that is confused with road. A
*reduced drive* is a folder that holds just these and the small files of the drive. Every command reads it like the
drive that it was made of, with the same results, bit by bit. This is the format, version 1::

    reduced.json                          the manifest, which makes the folder a reduced drive: write it last
    ground/labels/NNNNNN.ground           the ground points of one scan by the labels in labels/
    ground/predictions/NNNNNN.ground      likewise by those in predictions/
    poses.txt calib.txt times.txt geo.csv oxts/data/*.txt ...
                                          the small files of the drive, as they were

``NNNNNN`` is the scan number, with zeros in front to at least six digits.

**A .ground file** begins with 16 bytes: the letters ``ILGP``, then three unsigned 32-bit numbers, the lowest byte
first: the version (1), the count n of points (at most 4,000,000), and how many of them are road. The rest of the file
is one zlib stream (RFC 1950; in a browser ``CompressionStream("deflate")``) of exactly 12 n bytes.

Points come in the order of the scan, those of road first, then sidewalk, parking and other ground. To make the bytes,

1. take the float32 coordinates x, y, z (L, metres) as their 32 bits;
2. replace each by its difference to the same coordinate of the point before, modulo 2^32 (the first point: to 0);
3. fold the sign, so that -1, 1, -2 become 1, 2, 3: ``(d << 1) ^ (d >> 31)``, d as a signed 32-bit number;
4. write the highest byte of x of all points, then those of y, then those of z; then the next lower bytes of x, ...:
   twelve planes of n bytes.

In JavaScript, for a ``Uint32Array`` of n coordinates x (c = 0), y (c = 1) or z (c = 2) and a ``Uint8Array`` of 12 n::

    for (let i = 0, before = 0; i < n; before = bits[i++]) {
      const d = (bits[i] - before) | 0, folded = (d << 1) ^ (d >> 31);
      for (let k = 0; k < 4; k++) planes[(3 * k + c) * n + i] = folded >>> (24 - 8 * k);
    }

**reduced.json** is JSON of the model `interloc.drives.reduction.manifest.ReducedManifest`, whose fields are described
there. Scan numbers are written as runs, ``[first, count]``. An example, 1101 scans of which three were kept::

    {
      "format": "interloc-reduced-drive", "format_version": 1,
      "name": "07", "layout": "semantickitti",
      "scans": [[0, 1101]], "kept": [[0, 1], [19, 1], [31, 1]],
      "keyframes": {"distance_m": 2.0, "angle_deg": 5.0},
      "pose_frame": "camera", "pose_frame_reason": "it moves along its z axis ...",
      "files": {"poses": "poses.txt", "times": "times.txt", "calibration": ["calib.txt"], "oxts": null, "geo": null},
      "labels": [{"folder": "labels", "scheme": "semantickitti", "road": [40, 60], "confusable": [44, 48, 49],
                  "counts": {"0": 12, "40": 98765}, "label_bytes": 539000000}],
      "source": {"scan_bytes": 2156000000, "points_per_scan": 122515, "least_points": 118000, "most_points": 125000}
    }
"""
