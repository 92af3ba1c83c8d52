"""Label files of other tools: boxes, points and polygons, and folders of patches."""

NAMES = ("csv", "viame", "coco", "labelstudio", "coralnet", "biigle", "cvat", "ifdo", "patches")
CSV, VIAME, COCO, LABEL_STUDIO, CORALNET, BIIGLE, CVAT, IFDO, PATCHES = NAMES
