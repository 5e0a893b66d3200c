// Moves of Gaussians (MCMC densification). Each row of `moves` is (target, source); the final
// log-scales and logit of both are in `shape`. A row whose target is its source only changes
// those. No source is a target of another row.
// The Rust side is `RelocateUniform` in src/core/reconstruct/optimizer.rs.

struct RelocateUniform {
    rows: u32,
    // Floats of the harmonics of a Gaussian.
    sh_row: u32,
    pad_0: u32,
    pad_1: u32,
}
