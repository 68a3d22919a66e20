//! Numbers and vectors of eight pixels: the operations of [`crate::shade`] in the same order.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8};

use crate::single::Vec3;

pub(crate) type Wide<S> = f32x8<S>;
pub(crate) type Wide3<S> = [f32x8<S>; 3];

#[inline(always)]
pub(crate) fn floor<S: Simd>(simd: S, x: Wide<S>) -> Wide<S> {
    let whole = f32x8::splat(simd, 1.5 * (1 << 23) as f32);
    let near = (x + whole) - whole;
    near.simd_gt(x).select(near - f32x8::splat(simd, 1.0), near)
}

#[inline(always)]
pub(crate) fn lesser<S: Simd>(a: Wide<S>, b: Wide<S>) -> Wide<S> {
    a.simd_lt(b).select(a, b)
}

#[inline(always)]
pub(crate) fn greater<S: Simd>(a: Wide<S>, b: Wide<S>) -> Wide<S> {
    a.simd_gt(b).select(a, b)
}

/// Within 0 and 1.
#[inline(always)]
pub(crate) fn clamp<S: Simd>(simd: S, x: Wide<S>) -> Wide<S> {
    lesser(greater(x, f32x8::splat(simd, 0.0)), f32x8::splat(simd, 1.0))
}

#[inline(always)]
pub(crate) fn select<S: Simd>(mask: mask32x8<S>, a: Wide3<S>, b: Wide3<S>) -> Wide3<S> {
    [mask.select(a[0], b[0]), mask.select(a[1], b[1]), mask.select(a[2], b[2])]
}

#[inline(always)]
pub(crate) fn wide3<S: Simd>(simd: S, v: Vec3) -> Wide3<S> {
    [f32x8::splat(simd, v[0]), f32x8::splat(simd, v[1]), f32x8::splat(simd, v[2])]
}

#[inline(always)]
pub(crate) fn dot<S: Simd>(a: Wide3<S>, b: Wide3<S>) -> Wide<S> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(crate) fn add<S: Simd>(a: Wide3<S>, b: Wide3<S>) -> Wide3<S> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<S: Simd>(a: Wide3<S>, b: Wide3<S>) -> Wide3<S> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(crate) fn scale<S: Simd>(a: Wide3<S>, by: Wide<S>) -> Wide3<S> {
    [a[0] * by, a[1] * by, a[2] * by]
}

#[inline(always)]
pub(crate) fn product<S: Simd>(a: Wide3<S>, b: Wide3<S>) -> Wide3<S> {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub(crate) fn mix<S: Simd>(simd: S, a: Vec3, b: Vec3, share: Wide<S>) -> Wide3<S> {
    let (a, b) = (wide3(simd, a), wide3(simd, b));
    add(a, scale(sub(b, a), share))
}

#[inline(always)]
pub(crate) fn normalize<S: Simd>(simd: S, a: Wide3<S>) -> Wide3<S> {
    let square = greater(dot(a, a), f32x8::splat(simd, 1e-30));
    scale(a, f32x8::splat(simd, 1.0) / square.sqrt())
}
