// The intersections of a tile, in the sorted list of slots. The Rust side is `[u32; 3]`.

struct TileRange {
    // The first, and one past the last.
    first: u32,
    end: u32,
    // One past the last that counted when the tile was blended.
    last: u32,
}
