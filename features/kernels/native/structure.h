/* Sums of the structure tensor over patches: how levels change across, down, and both together. */
#ifndef TOKT_STRUCTURE_H
#define TOKT_STRUCTURE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum {
    STRUCTURE_SUMS = 3,
    STRUCTURE_ROWS = 4096 /* whose sums fit 32 bits */
};

/* A gray picture cut into equal patches. */
typedef struct {
    const uint8_t *pixels;
    int height, width, cols, patch_height, patch_width;
} PatchedPicture;

/* Int32 values that `structure_rows` needs as scratch. */
static size_t structure_scratch(const PatchedPicture *picture) {
    return STRUCTURE_SUMS * (size_t)picture->width;
}

/* Add the products of one row, column by column. A neighbour beyond the picture is taken to be
 * the other one, so that their difference is 0. */
TOKT_BODY void structure_add_row(const PatchedPicture *picture, int y, int32_t *TOKT_RESTRICT xx,
                                 int32_t *TOKT_RESTRICT yy, int32_t *TOKT_RESTRICT xy) {
    int width = picture->width, inside = y > 0 && y + 1 < picture->height;
    const uint8_t *TOKT_RESTRICT row = picture->pixels + (ptrdiff_t)y * width;
    const uint8_t *TOKT_RESTRICT above = inside ? row - width : row;
    const uint8_t *TOKT_RESTRICT below = inside ? row + width : row;
    for (int x = 1; x < width - 1; x++) {
        int32_t across = row[x + 1] - row[x - 1], down = below[x] - above[x];
        xx[x] += across * across;
        yy[x] += down * down;
        xy[x] += across * down;
    }
    int32_t left = below[0] - above[0], right = below[width - 1] - above[width - 1];
    yy[0] += left * left;
    yy[width - 1] += right * right;
}

/* Write the sums of patch rows first..last. */
TOKT_BODY void structure_rows_body(const PatchedPicture *picture, int first, int last,
                                   int32_t *scratch, int64_t *sums) {
    int width = picture->width;
    for (int row = first; row < last; row++) {
        int64_t *out = sums + (ptrdiff_t)row * picture->cols * STRUCTURE_SUMS;
        memset(out, 0, (size_t)picture->cols * STRUCTURE_SUMS * sizeof(int64_t));
        int y = row * picture->patch_height, end = y + picture->patch_height;
        while (y < end) {
            int stop = end - y > STRUCTURE_ROWS ? y + STRUCTURE_ROWS : end;
            memset(scratch, 0, STRUCTURE_SUMS * (size_t)width * sizeof(int32_t));
            for (; y < stop; y++)
                structure_add_row(picture, y, scratch, scratch + width, scratch + 2 * (size_t)width);
            for (int col = 0; col < picture->cols; col++)
                for (int kind = 0; kind < STRUCTURE_SUMS; kind++) {
                    const int32_t *part =
                        scratch + (size_t)kind * width + (size_t)col * picture->patch_width;
                    int64_t sum = 0;
                    for (int x = 0; x < picture->patch_width; x++) sum += part[x];
                    out[col * STRUCTURE_SUMS + kind] += sum;
                }
        }
    }
}

TOKT_VARIANTS(structure_rows,
              (const PatchedPicture *picture, int first, int last, int32_t *scratch, int64_t *sums),
              (picture, first, last, scratch, sums))

#endif
