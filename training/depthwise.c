/* The gradient of a depthwise convolution's weights. Tensors are f32 in channels-last order, [n, height, width, channels]. */
#include <string.h>

typedef float lanes __attribute__((vector_size(64), aligned(4), may_alias));
enum { LANES = 16 };

/* One row of the output's gradient against one row of the input, all taps of one kernel row. */
static inline __attribute__((always_inline)) void row(
    const float *input, const float *gradient, float *weights, long width, long channels, const int taps) {
    const int reach = taps / 2;
    for (long channel = 0; channel < channels; channel += LANES) {
        lanes sums[9] = {0};
        for (long x = 0; x < width; x++) {
            const lanes g = *(const lanes *)(gradient + x * channels + channel);
            if (x >= reach && x < width - reach) {
                const float *from = input + (x - reach) * channels + channel;
                for (int tap = 0; tap < taps; tap++) sums[tap] += g * *(const lanes *)(from + tap * channels);
            } else {
                for (int tap = 0; tap < taps; tap++) {
                    const long at = x + tap - reach;
                    if (at >= 0 && at < width) sums[tap] += g * *(const lanes *)(input + at * channels + channel);
                }
            }
        }
        for (int tap = 0; tap < taps; tap++) {
            lanes *to = (lanes *)(weights + tap * channels + channel);
            *to += sums[tap];
        }
    }
}

/* weights [taps, taps, channels]; 0, or 1 where there is no code for such a size. */
int depthwise_weights(const float *input, const float *gradient, float *weights, long n, long height, long width, long channels, int taps) {
    if (channels % LANES || (taps != 3 && taps != 5 && taps != 7 && taps != 9)) return 1;
    const int reach = taps / 2;
    memset(weights, 0, sizeof(float) * taps * taps * channels);
    for (long image = 0; image < n; image++)
        for (long y = 0; y < height; y++)
            for (int down = 0; down < taps; down++) {
                const long from = y + down - reach;
                if (from < 0 || from >= height) continue;
                const float *in = input + (image * height + from) * width * channels;
                const float *out = gradient + (image * height + y) * width * channels;
                float *to = weights + (long)down * taps * channels;
                switch (taps) {
                case 3: row(in, out, to, width, channels, 3); break;
                case 5: row(in, out, to, width, channels, 5); break;
                case 7: row(in, out, to, width, channels, 7); break;
                default: row(in, out, to, width, channels, 9);
                }
            }
    return 0;
}
