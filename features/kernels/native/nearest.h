/* Histograms of uniform local binary patterns sampled at whole pixels.
 *
 * With nothing to interpolate a point is one comparison of bytes, of which a processor does many
 * at a time; ones and changes along the chain of points are counted on the way. */
#ifndef TOKT_NEAREST_H
#define TOKT_NEAREST_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"
#include "structure.h"

enum {
    NEAREST_BINS = 64 + 2,
    NEAREST_LANES = 64 /* pixels that are worked on together; what is beyond a row is not used */
};

typedef struct {
    int points, reach;    /* reach: pixels that any point lies from the centre, at most */
    int across_patches;   /* a point beyond the patch is the neighbour's pixel, not 0 */
    const int32_t *moves; /* [points][2] rows and columns from the centre */
} NearestPoints;

/* A part of the picture, zeros around it where nothing may be read, and its patterns. */
typedef struct {
    int row, column, height, width;
    int wide;        /* the width, rounded up to NEAREST_LANES */
    int stride;      /* wide + 2 reach */
    uint8_t *padded; /* [height + 2 reach][stride] */
    uint8_t *codes;  /* [height][wide] */
    uint8_t *line;   /* [3][wide] ones, changes and the last bits of a row */
} NearestBlock;

TOKT_BODY int nearest_wide(int width) {
    return (width + NEAREST_LANES - 1) & -NEAREST_LANES;
}

/* Bytes that `nearest_rows` needs as scratch. */
static size_t nearest_scratch(const PatchedPicture *picture, const NearestPoints *points) {
    size_t width = nearest_wide(points->across_patches ? picture->width : picture->patch_width);
    size_t height = picture->patch_height, around = 2 * (size_t)points->reach;
    return (height + around) * (width + around) + (height + 3) * width;
}

TOKT_BODY void nearest_load(const NearestBlock *block, const PatchedPicture *picture,
                            const NearestPoints *points) {
    int reach = points->reach;
    for (int row = 0; row < block->height + 2 * reach; row++) {
        uint8_t *out = block->padded + (size_t)row * block->stride;
        int y = block->row + row - reach, top = 0, bottom = picture->height;
        if (!points->across_patches) top = block->row, bottom = block->row + block->height;
        memset(out, 0, block->stride);
        if (y >= top && y < bottom)
            memcpy(out + reach, picture->pixels + (ptrdiff_t)y * picture->width + block->column,
                   block->width);
    }
}

/* The patterns of a row: a uniform one's number of ones, of any other points + 1. */
TOKT_BODY void nearest_row(const NearestBlock *block, const NearestPoints *points, int row) {
    int width = block->wide & -NEAREST_LANES;
    const uint8_t *TOKT_RESTRICT centre =
        block->padded + (size_t)(row + points->reach) * block->stride + points->reach;
    uint8_t *TOKT_RESTRICT ones = block->line, *TOKT_RESTRICT changes = ones + width;
    uint8_t *TOKT_RESTRICT before = changes + width;
    uint8_t *TOKT_RESTRICT codes = block->codes + (size_t)row * width;
    uint8_t other = (uint8_t)(points->points + 1);
    for (int point = 0; point < points->points; point++) {
        const uint8_t *TOKT_RESTRICT at = centre +
                                          (ptrdiff_t)points->moves[2 * point] * block->stride +
                                          points->moves[2 * point + 1];
        if (point == 0) {
            for (int x = 0; x < width; x++) {
                ones[x] = before[x] = at[x] >= centre[x];
                changes[x] = 0;
            }
            continue;
        }
        for (int x = 0; x < width; x++) {
            uint8_t now = at[x] >= centre[x];
            ones[x] = (uint8_t)(ones[x] + now);
            changes[x] = (uint8_t)(changes[x] + (now ^ before[x]));
            before[x] = now;
        }
    }
    for (int x = 0; x < width; x++) {
        uint8_t number = ones[x]; /* read in any case: no branch */
        codes[x] = changes[x] > 2 ? other : number;
    }
}

/* Count the patterns of the block's patches; in two sets, as neighbours often have the same. */
TOKT_BODY void nearest_count(const NearestBlock *block, int patches, int patch_width, int bins,
                             int64_t *histograms) {
    for (int patch = 0; patch < patches; patch++) {
        int column = patch * patch_width;
        uint32_t counts[2][NEAREST_BINS];
        memset(counts, 0, sizeof counts);
        for (int row = 0; row < block->height; row++) {
            const uint8_t *codes = block->codes + (size_t)row * block->wide + column;
            for (int x = 0; x + 1 < patch_width; x += 2) {
                counts[0][codes[x]]++;
                counts[1][codes[x + 1]]++;
            }
            if (patch_width % 2) counts[0][codes[patch_width - 1]]++;
        }
        for (int bin = 0; bin < bins; bin++) *histograms++ = (int64_t)counts[0][bin] + counts[1][bin];
    }
}

/* Write the histograms of patch rows first..last. */
TOKT_BODY void nearest_rows_body(const PatchedPicture *picture, const NearestPoints *points,
                                 int first, int last, uint8_t *scratch, int64_t *histograms) {
    int bins = points->points + 2, blocks = points->across_patches ? 1 : picture->cols;
    NearestBlock block;
    block.height = picture->patch_height;
    block.width = points->across_patches ? picture->width : picture->patch_width;
    block.wide = nearest_wide(block.width);
    block.stride = block.wide + 2 * points->reach;
    block.padded = scratch;
    block.codes = scratch + (size_t)(block.height + 2 * points->reach) * block.stride;
    block.line = block.codes + (size_t)block.height * block.wide;
    for (int row = first; row < last; row++)
        for (int col = 0; col < blocks; col++) {
            block.row = row * block.height;
            block.column = col * block.width;
            nearest_load(&block, picture, points);
            for (int y = 0; y < block.height; y++) nearest_row(&block, points, y);
            nearest_count(&block, picture->cols / blocks, picture->patch_width, bins,
                          histograms + ((ptrdiff_t)row * picture->cols + col) * bins);
        }
}

TOKT_VARIANTS(nearest_rows,
              (const PatchedPicture *picture, const NearestPoints *points, int first, int last,
               uint8_t *scratch, int64_t *histograms),
              (picture, points, first, last, scratch, histograms))

#endif
