/* A view's local contrast: the standard deviation around each pixel, and the view made even by it.
 *
 * The bits of OpenCV's `boxFilter` and `sqrBoxFilter`: sums in double precision that are carried
 * from pixel to pixel along a row, then from row to row down a column. */
#ifndef TOKT_CONTRAST_H
#define TOKT_CONTRAST_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "instructions.h"

enum { CONTRAST_ALONE = 5 /* sums over windows up to this are not carried; those of squares are */ };
#define CONTRAST_WHOLE 12582912.0f /* 3 * 2^22: what is added to it is rounded to a whole number */

typedef struct {
    const float *view;
    ptrdiff_t height, width; /* both larger than the window */
    ptrdiff_t window;        /* height and width of what is around a pixel, odd, from 3 */
    float gain;              /* grey levels that one deviation becomes, around 128 */
    float least;             /* grey levels that a smaller deviation counts as */
} ContrastView;

/* Doubles that `contrast_view` needs as scratch: two totals a column, and the same for each row of
 * the window; beside them a row of floats. */
static size_t contrast_scratch(const ContrastView *view) {
    return (size_t)((2 * view->window + 3) * view->width + view->window);
}

/* A place beyond the picture's edge is its mirror image's. */
TOKT_BODY ptrdiff_t contrast_mirrored(ptrdiff_t at, ptrdiff_t length) {
    at = at < 0 ? -at : at;
    return at < length ? at : 2 * (length - 1) - at;
}

/* Write a row's sums over the window, then those of squares; `wide` is for the row and its edges. */
TOKT_BODY void contrast_sums(const ContrastView *view, const float *row,
                             float *TOKT_RESTRICT wide, double *TOKT_RESTRICT sums) {
    ptrdiff_t width = view->width, window = view->window, half = window / 2;
    for (ptrdiff_t x = 0; x <= half; x++) {
        wide[half - x] = row[x];
        wide[half + width - 1 + x] = row[width - 1 - x];
    }
    memcpy(wide + half, row, (size_t)width * sizeof *row);
    double sum = 0, square = 0;
    for (ptrdiff_t x = 0; x < window; x++) {
        sum += (double)wide[x];
        square += (double)wide[x] * wide[x];
    }
    sums[0] = sum, sums[width] = square;
    for (ptrdiff_t x = 1; x < width; x++) {
        double leave = wide[x - 1], enter = wide[x + window - 1];
        sums[x] = sum += enter - leave;
        sums[width + x] = square += enter * enter - leave * leave;
    }
    for (ptrdiff_t x = 1; x < width && window <= CONTRAST_ALONE; x++) {
        sums[x] = 0;
        for (ptrdiff_t i = x; i < x + window; i++) sums[x] += (double)wide[i];
    }
}

/* Write a row whose totals lack the row `enter`, and take `leave` away from them. */
TOKT_BODY void contrast_row(const ContrastView *view, const float *TOKT_RESTRICT row,
                            const double *TOKT_RESTRICT enter, const double *TOKT_RESTRICT leave,
                            double *TOKT_RESTRICT totals, float *TOKT_RESTRICT sigma,
                            uint8_t *TOKT_RESTRICT even) {
    ptrdiff_t width = view->width;
    double share = 1.0 / (double)(view->window * view->window);
    float least = view->least, gain = view->gain;
    for (ptrdiff_t x = 0; x < width; x++) {
        double sum = totals[x] + enter[x], square = totals[width + x] + enter[width + x];
        totals[x] = sum - leave[x];
        totals[width + x] = square - leave[width + x];
        float mean = (float)(sum * share), variance = (float)(square * share) - mean * mean;
        sigma[x] = sqrtf(variance > 0 ? variance : 0);
        float level = (row[x] - mean) * gain / (sigma[x] > least ? sigma[x] : least) + 128;
        int32_t whole = (int32_t)(level + CONTRAST_WHOLE - CONTRAST_WHOLE);
        whole = whole > 0 ? whole : 0;
        even[x] = (uint8_t)(whole < 255 ? whole : 255);
    }
}

/* Write the deviations around all pixels, and the even view. */
TOKT_BODY void contrast_view_body(const ContrastView *view, double *scratch, float *sigma,
                                  uint8_t *even) {
    ptrdiff_t width = view->width, height = view->height, half = view->window / 2;
    double *totals = scratch, *sums = totals + 2 * width; /* row y's are at y % window */
    float *wide = (float *)(sums + 2 * view->window * width);
    memset(totals, 0, 2 * (size_t)width * sizeof *totals);
    for (ptrdiff_t y = 0; y <= half; y++)
        contrast_sums(view, view->view + y * width, wide, sums + 2 * y * width);
    for (ptrdiff_t y = -2 * half; y < height; y++) {
        ptrdiff_t below = contrast_mirrored(y + half, height);
        ptrdiff_t above = contrast_mirrored(y - half, height);
        double *enter = sums + 2 * (below % view->window) * width;
        const double *leave = sums + 2 * (above % view->window) * width;
        if (y > 0 && y + half < height)
            contrast_sums(view, view->view + below * width, wide, enter);
        for (ptrdiff_t x = 0; y < 0 && x < 2 * width; x++) totals[x] += enter[x];
        if (y >= 0)
            contrast_row(view, view->view + y * width, enter, leave, totals, sigma + y * width,
                         even + y * width);
    }
}

TOKT_VARIANTS_TO_AVX2(contrast_view,
                      (const ContrastView *view, double *scratch, float *sigma, uint8_t *even),
                      (view, scratch, sigma, even))

#endif
