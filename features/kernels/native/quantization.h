/* A 16-bit gray picture flattened and quantized, and how often each level occurs in a patch.
 *
 * Sums over boxes are exact whole numbers; from there on the steps are those of
 * numpy_pictures.py, one by one, so that both give the same bits. */
#ifndef TOKT_QUANTIZATION_H
#define TOKT_QUANTIZATION_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

typedef struct {
    const uint16_t *pixels;
    int height, width;
} Gray16Picture;

typedef struct {
    int smooth, window; /* sides of the boxes, pixels, odd; a window of 0 does not flatten */
    int ratio;
    double ratio_of, min_around; /* in steps of the 16-bit gray picture */
    double offset, top;
} QuantizeSettings;

/* Sums over boxes around the pixels of one row. */
typedef struct {
    int side;             /* pixels, odd */
    uint32_t *before;     /* [width + side] sums of the box's rows, of the columns before each */
    double *share;        /* [width] one by the box's columns that lie in the picture */
    double rows;          /* one by the box's rows that lie in the picture */
} QuantizeBox;

enum { QUANTIZE_VALUES = 256 };

static size_t quantize_box_scratch(int width, int side) { return (size_t)width * 2 + side + 1; }

/* Doubles that `quantize_rows` needs as scratch. */
static size_t quantize_scratch(const QuantizeSettings *settings, int width) {
    return quantize_box_scratch(width, settings->smooth) +
           quantize_box_scratch(width, settings->window) + width;
}

TOKT_BODY int quantize_min(int one, int two) { return one < two ? one : two; }
TOKT_BODY int quantize_max(int one, int two) { return one > two ? one : two; }

/* Add a row to the columns' sums, `times` 1, or take it away: -1. */
TOKT_BODY void quantize_add_row(const Gray16Picture *picture, int y, int times,
                                uint32_t *TOKT_RESTRICT column) {
    const uint16_t *TOKT_RESTRICT row = picture->pixels + (ptrdiff_t)y * picture->width;
    for (int x = 0; x < picture->width; x++) column[x] += (uint32_t)times * row[x];
}

/* Write the sum of all pixels above and left of each corner, (height + 1, width + 1). They run
 * over: what is taken from them is a difference that fits. */
static void summed_area(const Gray16Picture *picture, uint32_t *sums) {
    size_t corners = (size_t)picture->width + 1;
    memset(sums, 0, corners * sizeof(uint32_t));
    for (int y = 0; y < picture->height; y++) {
        const uint16_t *row = picture->pixels + (ptrdiff_t)y * picture->width;
        const uint32_t *above = sums + y * corners;
        uint32_t *out = sums + (y + 1) * corners, sum = 0;
        out[0] = 0;
        for (int x = 0; x < picture->width; x++) out[x + 1] = above[x + 1] + (sum += row[x]);
    }
}

static double *quantize_lay_out(QuantizeBox *box, int side, int width, double *memory) {
    int reach = side / 2;
    box->side = side;
    box->share = memory;
    box->before = (uint32_t *)(memory + width);
    for (int x = 0; x < width; x++)
        box->share[x] = 1.0 / (quantize_min(x + reach, width - 1) - quantize_max(x - reach, 0) + 1);
    return memory + quantize_box_scratch(width, side);
}

/* Sum the rows of the boxes around row y, up to each column; beyond the picture are no pixels. */
TOKT_BODY void quantize_box(const uint32_t *sums, int height, int width, int y, QuantizeBox *box) {
    int reach = box->side / 2, top = quantize_max(y - reach, 0);
    int bottom = quantize_min(y + reach + 1, height);
    const uint32_t *TOKT_RESTRICT above = sums + (size_t)top * (width + 1);
    const uint32_t *TOKT_RESTRICT below = sums + (size_t)bottom * (width + 1);
    uint32_t *TOKT_RESTRICT inside = box->before + reach;
    memset(box->before, 0, reach * sizeof(uint32_t));
    for (int x = 0; x <= width; x++) inside[x] = below[x] - above[x];
    uint32_t all = inside[width], *beyond = inside + width;
    for (int x = 1; x <= reach; x++) beyond[x] = all;
    box->rows = 1.0 / (bottom - top);
}

/* Write one row in levels; `flat` and `ratio` are known where this is called. */
TOKT_BODY void quantize_row(const QuantizeBox *small, const QuantizeBox *large,
                            const QuantizeSettings *settings, double scale, int width, int flat,
                            int ratio, int32_t *TOKT_RESTRICT rounded, uint8_t *levels) {
    const uint32_t *TOKT_RESTRICT near = small->before, *TOKT_RESTRICT wide = large->before;
    const uint32_t *TOKT_RESTRICT near_end = near + small->side;
    const uint32_t *TOKT_RESTRICT wide_end = wide + large->side;
    const double *TOKT_RESTRICT near_share = small->share;
    const double *TOKT_RESTRICT wide_share = large->share;
    double near_rows = small->rows, wide_rows = large->rows;
    double offset = settings->offset, top = settings->top;
    double ratio_of = settings->ratio_of, least = settings->min_around;
    for (int x = 0; x < width; x++) {
        double level = (double)(near_end[x] - near[x]) * near_share[x] * near_rows;
        double around = flat ? (double)(wide_end[x] - wide[x]) * wide_share[x] * wide_rows : 0;
        if (flat) level -= around;
        if (ratio) level = level * ratio_of / (around > least ? around : least);
        level = level * scale + offset;
        level = level > 0 ? level : 0;
        level = level < top ? level : top;
        rounded[x] = (int32_t)level;
    }
    /* Apart, as a loop that writes bytes leaves dozens of pixels to be done one by one. */
    for (int x = 0; x < width; x++) levels[x] = (uint8_t)rounded[x];
}

/* Rows first..last of the picture in levels, by its `summed_area`; `scale` is how many levels a
 * step becomes. */
TOKT_BODY void quantize_rows_body(const uint32_t *sums, int height, int width,
                                  const QuantizeSettings *settings, double scale, int first,
                                  int last, double *scratch, uint8_t *out) {
    QuantizeBox small, large;
    int32_t *rounded = (int32_t *)quantize_lay_out(
        &large, settings->window, width,
        quantize_lay_out(&small, settings->smooth, width, scratch));
    for (int y = first; y < last; y++) {
        uint8_t *levels = out + (ptrdiff_t)y * width;
        quantize_box(sums, height, width, y, &small);
        if (settings->window > 0) quantize_box(sums, height, width, y, &large);
        if (settings->window == 0)
            quantize_row(&small, &large, settings, scale, width, 0, 0, rounded, levels);
        else if (!settings->ratio)
            quantize_row(&small, &large, settings, scale, width, 1, 0, rounded, levels);
        else
            quantize_row(&small, &large, settings, scale, width, 1, 1, rounded, levels);
    }
}

TOKT_VARIANTS(quantize_rows,
              (const uint32_t *sums, int height, int width, const QuantizeSettings *settings,
               double scale, int first, int last, double *scratch, uint8_t *out),
              (sums, height, width, settings, scale, first, last, scratch, out))

/* Add a patch's levels to its 256 counts; in two sets, as neighbours often have the same. */
static void count_levels(const uint8_t *pixels, ptrdiff_t stride, int height, int width,
                         int64_t *counts) {
    uint32_t other[2][QUANTIZE_VALUES];
    memset(other, 0, sizeof other);
    for (int y = 0; y < height; y++) {
        const uint8_t *row = pixels + y * stride;
        for (int x = 0; x < width; x++) other[x & 1][row[x]]++;
    }
    for (int level = 0; level < QUANTIZE_VALUES; level++)
        counts[level] = (int64_t)other[0][level] + other[1][level];
}

#endif
