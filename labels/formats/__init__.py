"""Label files of other tools: VIAME CSV, COCO, Label Studio JSON, folders of patches."""
