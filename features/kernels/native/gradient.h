/* Gradients of a smoothed 16-bit gray picture over patches: their sums, and the strong ones.
 *
 * Squares are doubles: whole numbers below 2**53, whose upper bits are the bucket they count in. */
#ifndef TOKT_GRADIENT_H
#define TOKT_GRADIENT_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"
#include "quantization.h"

enum {
    GRADIENT_SUMS = 3,
    GRADIENT_ROWS = 4096, /* whose sums doubles hold exactly */
    GRADIENT_SHIFT = 49, /* leaves a double's exponent and 3 digits: an eighth of an octave */
    GRADIENT_BELOW = 0x1FF7, /* the bucket just below that of 1; 0 is counted there */
    GRADIENT_BUCKETS = 1 + 8 * 33 /* squares are below 2**33 */
};

typedef struct {
    Gray16Picture picture;
    int cols, patch_height, patch_width, box;
} GradientPatches;

typedef struct {
    double *across, *down; /* [width] sums of squares, column by column */
    double *square;        /* [width] of one row */
    uint32_t *counts;      /* [cols][2][GRADIENT_BUCKETS] */
    uint32_t *column;      /* [width] sums of the box's rows */
    uint32_t *wide;        /* [width + box] the same, the outermost ones repeated */
    uint32_t *sums;        /* [width] of the box */
    uint32_t *bucket;      /* [width] of a row's squares */
    int32_t *means[3];     /* [-1 .. width] of rows y, at y % 3 */
} GradientStrip;

/* Doubles that `gradient_rows` needs as scratch. */
static size_t gradient_scratch(const GradientPatches *patches) {
    return 7 * (size_t)patches->picture.width + (size_t)patches->cols * GRADIENT_BUCKETS +
           patches->box + 4;
}

static void gradient_lay_out(GradientStrip *strip, const GradientPatches *patches, double *memory) {
    size_t width = (size_t)patches->picture.width;
    strip->across = memory;
    strip->down = memory + width;
    strip->square = memory + 2 * width;
    strip->counts = (uint32_t *)(memory + 3 * width);
    strip->column = strip->counts + 2 * (size_t)patches->cols * GRADIENT_BUCKETS;
    strip->wide = strip->column + width;
    strip->sums = strip->wide + width + patches->box;
    strip->bucket = strip->sums + width;
    int32_t *means = (int32_t *)(strip->bucket + width) + 1;
    for (int i = 0; i < 3; i++) strip->means[i] = means + i * (width + 2);
}

/* The means of row y, when those of the row before were made last or y is the first one. */
TOKT_BODY void gradient_make_means(const GradientPatches *patches, GradientStrip *strip, int y,
                                   int first) {
    const Gray16Picture *picture = &patches->picture;
    int width = picture->width, lowest = picture->height - 1, side = patches->box;
    int reach = side / 2;
    int32_t *TOKT_RESTRICT means = strip->means[y % 3];
    if (side == 1) {
        const uint16_t *TOKT_RESTRICT row = picture->pixels + (ptrdiff_t)y * width;
        for (int x = 0; x < width; x++) means[x] = row[x];
    } else {
        uint32_t *TOKT_RESTRICT wide = strip->wide;
        uint32_t *TOKT_RESTRICT sums = strip->sums;
        if (y == first) {
            memset(strip->column, 0, (size_t)width * sizeof(uint32_t));
            for (int row = y - reach; row <= y + reach; row++)
                quantize_add_row(picture, quantize_min(quantize_max(row, 0), lowest), 1,
                                 strip->column);
        } else {
            quantize_add_row(picture, quantize_min(y + reach, lowest), 1, strip->column);
            quantize_add_row(picture, quantize_max(y - reach - 1, 0), -1, strip->column);
        }
        memcpy(wide + reach, strip->column, (size_t)width * sizeof(uint32_t));
        for (int x = 0; x < reach; x++) {
            wide[x] = strip->column[0];
            wide[reach + width + x] = strip->column[width - 1];
        }
        uint32_t area = (uint32_t)(side * side);
        /* Sums are below 2**24 and areas below 2**8: this inverse divides them exactly. */
        uint32_t inverse = (uint32_t)((((uint64_t)1 << 32) + area - 1) / area);
        for (int x = 0; x < width; x++) sums[x] = area / 2;
        for (int i = 0; i < side; i++)
            for (int x = 0; x < width; x++) sums[x] += wide[x + i];
        for (int x = 0; x < width; x++)
            means[x] = (int32_t)(((uint64_t)sums[x] * inverse) >> 32);
    }
    /* Mirrored, so that the outermost have no gradient. */
    means[-1] = means[1];
    means[width] = means[width - 2];
}

/* Add the squares of row y, and count them. */
TOKT_BODY void gradient_add_row(const GradientPatches *patches, const GradientStrip *strip, int y) {
    int width = patches->picture.width, inside = y > 0 && y + 1 < patches->picture.height;
    const int32_t *TOKT_RESTRICT row = strip->means[y % 3];
    const int32_t *TOKT_RESTRICT above = strip->means[inside ? (y - 1) % 3 : y % 3];
    const int32_t *TOKT_RESTRICT below = strip->means[inside ? (y + 1) % 3 : y % 3];
    double *TOKT_RESTRICT across = strip->across;
    double *TOKT_RESTRICT down = strip->down;
    double *TOKT_RESTRICT square = strip->square;
    for (int x = 0; x < width; x++) {
        double gx = row[x + 1] - row[x - 1], gy = below[x] - above[x];
        across[x] += gx * gx;
        down[x] += gy * gy;
        square[x] = gx * gx + gy * gy;
    }
    uint32_t *TOKT_RESTRICT bucket = strip->bucket;
    for (int x = 0; x < width; x++) {
        uint64_t bits;
        memcpy(&bits, square + x, sizeof bits);
        int32_t over = (int32_t)(bits >> GRADIENT_SHIFT) - GRADIENT_BELOW;
        bucket[x] = over > 0 ? (uint32_t)over : 0;
    }
    for (int col = 0; col < patches->cols; col++) {
        /* Two sets, as neighbours often have the same bucket. */
        uint32_t *counts = strip->counts + 2 * (size_t)col * GRADIENT_BUCKETS;
        for (int x = 0; x < patches->patch_width; x++)
            counts[(x & 1) * GRADIENT_BUCKETS + bucket[x]]++;
        bucket += patches->patch_width;
    }
}

/* The lower edge of the first bucket up to which 19 of 20 are counted. */
static int64_t gradient_strong(const uint32_t *counts, int64_t pixels) {
    int64_t counted = 0;
    int bucket = -1;
    while (20 * counted < 19 * pixels) {
        bucket++;
        counted += (int64_t)counts[bucket] + counts[GRADIENT_BUCKETS + bucket];
    }
    uint64_t bits = (uint64_t)(GRADIENT_BELOW + bucket) << GRADIENT_SHIFT;
    double edge;
    memcpy(&edge, &bits, sizeof edge);
    return (int64_t)edge; /* that of the lowest bucket, under 1, becomes 0 */
}

/* Write the sums of patch rows first..last. */
TOKT_BODY void gradient_rows_body(const GradientPatches *patches, int first, int last,
                                  double *scratch, int64_t *sums) {
    GradientStrip strip;
    gradient_lay_out(&strip, patches, scratch);
    int width = patches->picture.width, lowest = patches->picture.height - 1;
    int64_t pixels = (int64_t)patches->patch_height * patches->patch_width;
    int start = quantize_max(first * patches->patch_height - 1, 0), made = start;
    for (int row = first; row < last; row++) {
        int64_t *out = sums + (ptrdiff_t)row * patches->cols * GRADIENT_SUMS;
        memset(out, 0, (size_t)patches->cols * GRADIENT_SUMS * sizeof(int64_t));
        memset(strip.counts, 0, 2 * (size_t)patches->cols * GRADIENT_BUCKETS * sizeof(uint32_t));
        int y = row * patches->patch_height, end = y + patches->patch_height;
        while (y < end) {
            int stop = quantize_min(end, y + GRADIENT_ROWS);
            memset(strip.across, 0, 2 * (size_t)width * sizeof(double)); /* and down */
            for (; y < stop; y++) {
                for (; made <= quantize_min(y + 1, lowest); made++)
                    gradient_make_means(patches, &strip, made, start);
                gradient_add_row(patches, &strip, y);
            }
            for (int col = 0, x = 0; col < patches->cols; col++)
                for (int next = x + patches->patch_width; x < next; x++) {
                    out[col * GRADIENT_SUMS] += (int64_t)strip.across[x];
                    out[col * GRADIENT_SUMS + 1] += (int64_t)strip.down[x];
                }
        }
        for (int col = 0; col < patches->cols; col++)
            out[col * GRADIENT_SUMS + 2] =
                gradient_strong(strip.counts + 2 * (size_t)col * GRADIENT_BUCKETS, pixels);
    }
}

TOKT_VARIANTS(gradient_rows,
              (const GradientPatches *patches, int first, int last, double *scratch, int64_t *sums),
              (patches, first, last, scratch, sums))

#endif
