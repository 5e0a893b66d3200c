//! Small linear algebra over sixteen lanes.

use fearless_simd::prelude::*;

use crate::simd::{F, each};

pub(crate) type V3<S> = [F<S>; 3];

#[inline(always)]
pub(crate) fn dot<S: Simd>(a: V3<S>, b: V3<S>) -> F<S> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

#[inline(always)]
pub(crate) fn scaled<S: Simd>(a: V3<S>, by: F<S>) -> V3<S> {
    each!([0, 1, 2] n => a[n] * by)
}

/// a x + b y.
#[inline(always)]
pub(crate) fn blend<S: Simd>(a: V3<S>, x: F<S>, b: V3<S>, y: F<S>) -> V3<S> {
    each!([0, 1, 2] n => b[n].mul_add(y, a[n] * x))
}

#[inline(always)]
pub(crate) fn length<S: Simd>(a: V3<S>) -> F<S> {
    dot(a, a).sqrt()
}

/// A symmetric matrix [xx, xy, xz, yy, yz, zz] times a vector.
#[inline(always)]
pub(crate) fn symmetric<S: Simd>(m: &[F<S>; 6], v: V3<S>) -> V3<S> {
    [dot([m[0], m[1], m[2]], v), dot([m[1], m[3], m[4]], v), dot([m[2], m[4], m[5]], v)]
}
