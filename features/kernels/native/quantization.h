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

/* Sums over a box that moves down the picture. */
typedef struct {
    int reach;         /* pixels from its centre to its edge */
    uint32_t *column;  /* [width] sums of the box's rows */
    uint32_t *up_to;   /* [width + 2 reach + 1] sums of the columns before; they may run over */
    double *share;     /* [width] one by the box's columns that lie in the picture */
    uint32_t *sums;    /* [width] of a narrow box */
    double *mean;      /* [width] */
} QuantizeBox;

enum {
    QUANTIZE_VALUES = 256,
    QUANTIZE_NARROW = 11 /* side of a box up to which columns are added one by one */
};

static size_t quantize_box_scratch(int width, int side) { return (size_t)width * 5 + side + 1; }

/* Doubles that `quantize_rows` needs as scratch. */
static size_t quantize_scratch(const QuantizeSettings *settings, int width) {
    return quantize_box_scratch(width, settings->smooth) +
           quantize_box_scratch(width, settings->window);
}

TOKT_BODY int quantize_min(int one, int two) { return one < two ? one : two; }
TOKT_BODY int quantize_max(int one, int two) { return one > two ? one : two; }

static double *quantize_lay_out(QuantizeBox *box, int side, int width, double *memory) {
    box->reach = side / 2;
    box->share = memory;
    box->mean = memory + width;
    box->column = (uint32_t *)(memory + 2 * (size_t)width);
    box->sums = (uint32_t *)(memory + 3 * (size_t)width);
    box->up_to = (uint32_t *)(memory + 4 * (size_t)width);
    for (int x = 0; x < width; x++)
        box->share[x] =
            1.0 / (quantize_min(x + box->reach, width - 1) - quantize_max(x - box->reach, 0) + 1);
    memset(box->column, 0, (size_t)width * sizeof(uint32_t));
    memset(box->up_to, 0, ((size_t)width + side + 1) * sizeof(uint32_t));
    return memory + quantize_box_scratch(width, side);
}

/* Add a row to the columns' sums, `times` 1, or take it away: -1. */
TOKT_BODY void quantize_add_row(const Gray16Picture *picture, int y, int times,
                                uint32_t *TOKT_RESTRICT column) {
    const uint16_t *TOKT_RESTRICT row = picture->pixels + (ptrdiff_t)y * picture->width;
    for (int x = 0; x < picture->width; x++) column[x] += (uint32_t)times * row[x];
}

/* The box's means for row y, when the row before was done last or y is the first one. */
TOKT_BODY void quantize_box(const Gray16Picture *picture, QuantizeBox *box, int y, int first) {
    int width = picture->width, reach = box->reach;
    if (reach == 0) {
        const uint16_t *TOKT_RESTRICT row = picture->pixels + (ptrdiff_t)y * width;
        double *TOKT_RESTRICT mean = box->mean;
        for (int x = 0; x < width; x++) mean[x] = row[x];
        return;
    }
    int top = quantize_max(y - reach, 0), bottom = quantize_min(y + reach, picture->height - 1);
    if (y == first) {
        for (int row = top; row <= bottom; row++) quantize_add_row(picture, row, 1, box->column);
    } else {
        if (y + reach < picture->height) quantize_add_row(picture, y + reach, 1, box->column);
        if (y > reach) quantize_add_row(picture, y - reach - 1, -1, box->column);
    }
    int side = 2 * reach + 1;
    const double *TOKT_RESTRICT share = box->share;
    double *TOKT_RESTRICT mean = box->mean;
    double rows = 1.0 / (bottom - top + 1);
    if (side <= QUANTIZE_NARROW) {
        /* `up_to` holds the columns themselves, zeros beside them. */
        uint32_t *TOKT_RESTRICT sums = box->sums;
        memcpy(box->up_to + reach, box->column, (size_t)width * sizeof(uint32_t));
        memset(sums, 0, (size_t)width * sizeof(uint32_t));
        for (int i = 0; i < side; i++) {
            const uint32_t *TOKT_RESTRICT column = box->up_to + i;
            for (int x = 0; x < width; x++) sums[x] += column[x];
        }
        for (int x = 0; x < width; x++) mean[x] = (double)sums[x] * share[x] * rows;
        return;
    }
    uint32_t sum = 0;
    uint32_t *up_to = box->up_to + reach + 1;
    for (int x = 0; x < width; x++) up_to[x] = sum += box->column[x];
    for (int x = width; x < width + reach; x++) up_to[x] = sum;
    const uint32_t *TOKT_RESTRICT before = box->up_to;
    for (int x = 0; x < width; x++)
        mean[x] = (double)(before[x + side] - before[x]) * share[x] * rows;
}

/* Rows first..last of the picture in levels; `scale` is how many levels a step becomes. */
TOKT_BODY void quantize_rows_body(const Gray16Picture *picture, const QuantizeSettings *settings,
                                  double scale, int first, int last, double *scratch,
                                  uint8_t *out) {
    int width = picture->width;
    QuantizeBox small, large;
    quantize_lay_out(&large, settings->window, width,
                     quantize_lay_out(&small, settings->smooth, width, scratch));
    int flat = settings->window > 0, ratio = flat && settings->ratio;
    const double *TOKT_RESTRICT value = small.mean;
    const double *TOKT_RESTRICT around = large.mean;
    double offset = settings->offset, top = settings->top;
    double ratio_of = settings->ratio_of, least = settings->min_around;
    for (int y = first; y < last; y++) {
        uint8_t *TOKT_RESTRICT levels = out + (ptrdiff_t)y * width;
        quantize_box(picture, &small, y, first);
        if (flat) quantize_box(picture, &large, y, first);
        for (int x = 0; x < width; x++) {
            double level = value[x];
            if (flat) level -= around[x];
            if (ratio) level = level * ratio_of / (around[x] > least ? around[x] : least);
            level = level * scale + offset;
            level = level > 0 ? level : 0;
            level = level < top ? level : top;
            levels[x] = (uint8_t)(int32_t)level;
        }
    }
}

TOKT_VARIANTS(quantize_rows,
              (const Gray16Picture *picture, const QuantizeSettings *settings, double scale,
               int first, int last, double *scratch, uint8_t *out),
              (picture, settings, scale, first, last, scratch, out))

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
