// Masks of a bit a pixel, 32 pixels a word, the first in the lowest bit.

// Whether the mask holds a pixel, from the `word` that has its bit.
fn holds(word: u32, pixel: u32) -> bool {
    return (word >> (pixel & 31u) & 1u) == 1u;
}
