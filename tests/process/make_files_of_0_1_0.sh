#!/bin/sh
# How files_of_0_1_0.tar.xz was made, with tokt 0.1.0 (commit 375c755) in an empty /srv/tokt-0.1.0.
set -e
tokt simulate dive --frames 24 --width 240 --seed 3
tokt keygen boat
tokt labels import dive/labels.csv --workspace work
tokt dataset build tower --mission dive --labels dive/labels.csv --workspace work --block 4
tokt train tower --extractor lbp --name tower --folds 3 --embargo 1 --workspace work
tokt train tower --extractor haralick --name tower --folds 3 --embargo 1 --workspace work
tokt models alias tower/1 champion --workspace work
tokt export tower/1 -o tower-1.tokt --workspace work
tokt export tower/2 -o tower-2.tokt --sign boat.key --workspace work
tokt deploy tower-1.tokt store --reason "first"
tokt store store --trust boat.pub --reason "keys"
tokt deploy tower-2.tokt store --reason "signed"
tokt run --store store --source dive --log run.jsonl --log-values --record rec --format v2
rm -rf boat.key work/cache store/*.spare dive/depth dive/masks dive/Right \
    work/mlartifacts/*/artifacts/plots
# Of the recording its first two frames, as of a run that was killed then.
cd rec/run-*
sed -i '5,$d' recording.jsonl
ls Left/*.png | grep -vE '_L_[12]\.png$' | xargs rm
cd ../..
tar -cf - . | xz -9e > ../files_of_0_1_0.tar.xz
