//! Tests of a densification on the device.

use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::*;
use crate::reconstruct::densify;
use crate::splat::rows::pack_geometry;

#[test]
fn relocation_copies_splits_and_clears_on_the_device() {
    relocates(fixtures::gpu(), 1);
    // Six parts of four rows, and moves in chunks of six: copies cross from part to part.
    relocates(&Gpu::binding_at_most("auto", 1_024).expect("an adapter"), 6);
}

fn relocates(gpu: &Gpu, parts: usize) {
    let mut gaussians = fixtures::gaussians(20, 2, 9);
    gaussians.opacity_logits[4] = -8.0;
    let mut device = DeviceGaussians::upload(gpu, &gaussians, 24).expect("uploaded");
    assert_eq!(device.parts.len(), parts);
    let optimizer = Optimizer::new(gpu, &device, false).expect("created");
    optimizer.geometry_moments.write(&vec![1.0; 24 * 24]).expect("written");
    optimizer.sh_moments.write(&vec![1.0; 24 * 56]).expect("written");
    let rows = pack_geometry(&gaussians);
    let plan = densify::plan(&rows, 22, &mut Pcg64::seed_from_u64(3));
    optimizer.relocate(gpu, &device, &plan).expect("relocated");
    device.count = plan.count;
    let after = device.download().expect("read");
    let (geometry, sh) = (optimizer.geometry_moments.read(24), optimizer.sh_moments.read(24));
    let (geometry, sh) = (geometry.expect("read"), sh.expect("read"));
    assert_eq!(after.len(), 22);
    let touched: Vec<_> = plan.moves.iter().map(|m| m[0] as usize).collect();
    assert!(touched.contains(&4) && touched.contains(&20) && touched.contains(&21));
    for (&[to, from], shape) in plan.moves.iter().zip(&plan.shapes) {
        let (to, from) = (to as usize, from as usize);
        assert_eq!(after.means[to], gaussians.means[from]);
        assert_eq!(after.quats[to], gaussians.quats[from]);
        assert_eq!(after.log_scales[to], shape[..3]);
        assert_eq!(after.opacity_logits[to], shape[3]);
        assert_eq!(after.sh[27 * to..27 * to + 27], gaussians.sh[27 * from..27 * from + 27]);
    }
    for i in 0..20 {
        let expected = if touched.contains(&i) { 0.0 } else { 1.0 };
        assert!(geometry[24 * i..24 * i + 24].iter().all(|v| *v == expected), "{i}");
        assert!(sh[56 * i..56 * i + 56].iter().all(|v| *v == expected), "{i}");
    }
}
