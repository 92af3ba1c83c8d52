"""Label files of other tools: VIAME CSV, COCO, Label Studio JSON, folders of patches."""

NAMES = CSV, VIAME, COCO, LABEL_STUDIO, PATCHES = "csv", "viame", "coco", "labelstudio", "patches"
