//! The sRGB transfer function of IEC 61966-2-1.

use super::{Image, Linear, Srgb};

/// Linear light of an sRGB-encoded value. Odd around 0, unbounded above 1: nothing is clipped.
pub fn srgb_to_linear(value: f32) -> f32 {
    let magnitude = value.abs();
    let linear = if magnitude <= 0.040_45 {
        magnitude / 12.92
    } else {
        ((magnitude + 0.055) / 1.055).powf(2.4)
    };
    linear.copysign(value)
}

/// The sRGB-encoded value of linear light. The inverse of [`srgb_to_linear`].
pub fn linear_to_srgb(value: f32) -> f32 {
    let magnitude = value.abs();
    let encoded = if magnitude <= 0.003_130_8 {
        12.92 * magnitude
    } else {
        1.055 * magnitude.powf(1.0 / 2.4) - 0.055
    };
    encoded.copysign(value)
}

impl Image<Srgb> {
    /// The same picture in linear light.
    pub fn to_linear(&self) -> Image<Linear> {
        Image::from_planar(
            self.width,
            self.height,
            self.data.iter().map(|&v| srgb_to_linear(v)).collect(),
        )
    }
}

impl Image<Srgb> {
    /// The picture with its exposure raised by `ev` stops: a gain of `2^ev` in linear light.
    /// Nothing is clipped; at 0 it is unchanged, bit for bit.
    #[must_use]
    pub fn exposed(self, ev: f64) -> Self {
        if ev == 0.0 {
            return self;
        }
        let gain = ev.exp2() as f32;
        self.map(|value| linear_to_srgb(gain * srgb_to_linear(value)))
    }
}

impl Image<Linear> {
    /// The same picture, sRGB-encoded.
    pub fn to_srgb(&self) -> Image<Srgb> {
        Image::from_planar(
            self.width,
            self.height,
            self.data.iter().map(|&v| linear_to_srgb(v)).collect(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_doubles_the_light_and_none_changes_nothing() {
        let image = Image::<Srgb>::from_planar(1, 1, vec![0.02, 0.4, 0.9]);
        assert_eq!(image.clone().exposed(0.0), image);
        let light = |image: &Image<Srgb>| image.to_linear().data().to_vec();
        let brighter = light(&image.clone().exposed(1.0));
        for (before, after) in light(&image).iter().zip(brighter) {
            assert!((after / before - 2.0).abs() < 1e-4, "{before} {after}");
        }
    }

    #[test]
    fn the_transfer_function_has_the_published_values_and_an_inverse() {
        assert!((srgb_to_linear(0.5) - 0.214_041_14).abs() < 1e-6);
        assert!((linear_to_srgb(0.18) - 0.461_356_13).abs() < 1e-6);
        for step in 0..=1000 {
            let value = step as f32 / 1000.0;
            assert!((linear_to_srgb(srgb_to_linear(value)) - value).abs() < 1e-5, "{value}");
        }
    }
}
