//! One network for views without a guide, another for those with one.

use crate::deblur::{DeblurError, Restorer, RestorerInfo, same_size};
use crate::image::Image;

/// A published network without guide channels may be the better one for round 1, where there is no
/// render yet; the rounds after it need one that takes a guide.
pub struct ByGuide {
    unguided: Box<dyn Restorer>,
    guided: Box<dyn Restorer>,
}

impl ByGuide {
    /// `unguided` restores views without a guide, `guided` those with one.
    pub fn new(unguided: Box<dyn Restorer>, guided: Box<dyn Restorer>) -> Self {
        Self { unguided, guided }
    }
}

impl Restorer for ByGuide {
    fn restore(&mut self, blurry: &Image, guide: Option<&Image>) -> Result<Image, DeblurError> {
        same_size(blurry, guide)?;
        match guide {
            Some(guide) => self.guided.restore(blurry, Some(guide)),
            None => self.unguided.restore(blurry, None),
        }
    }

    fn describe(&self) -> RestorerInfo {
        self.guided.describe()
    }

    fn unguided(&self) -> Option<RestorerInfo> {
        Some(self.unguided.describe())
    }

    fn take_warnings(&mut self) -> Vec<String> {
        let mut warnings = self.unguided.take_warnings();
        warnings.extend(self.guided.take_warnings());
        warnings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a grey level and warns with it.
    struct Grey(f32);

    impl Restorer for Grey {
        fn restore(&mut self, blurry: &Image, _: Option<&Image>) -> Result<Image, DeblurError> {
            Ok(blurry.map(|_| self.0))
        }

        fn describe(&self) -> RestorerInfo {
            RestorerInfo {
                id: self.0.to_string(),
                sha256: String::new(),
                provider: String::new(),
                channels: 3,
                feeding: String::new(),
            }
        }

        fn take_warnings(&mut self) -> Vec<String> {
            vec![self.0.to_string()]
        }
    }

    #[test]
    fn a_guide_decides_which_network_restores_the_view() {
        let mut both = ByGuide::new(Box::new(Grey(0.25)), Box::new(Grey(0.75)));
        let view = Image::new(2, 2);
        assert_eq!(
            both.restore(&view, None).expect("no guide").get(0, 0),
            [0.25; 3]
        );
        assert_eq!(
            both.restore(&view, Some(&view)).expect("a guide").get(0, 0),
            [0.75; 3]
        );
        assert!(both.restore(&view, Some(&Image::new(1, 2))).is_err());
        assert_eq!(both.describe().id, "0.75");
        assert_eq!(both.unguided().map(|info| info.id).as_deref(), Some("0.25"));
        assert_eq!(both.take_warnings(), ["0.25", "0.75"]);
    }
}
