//! One white balance for the raw files of a camera.

use std::collections::HashMap;

use crate::image::RawHeader;

/// The white balance of each camera of a capture: the median of its raw files. Cameras choose
/// another one for each photograph; a scene has one.
pub(super) struct WhiteBalances(HashMap<String, [f32; 3]>);

impl WhiteBalances {
    pub(super) fn of<'a>(headers: impl Iterator<Item = &'a RawHeader>) -> Self {
        let mut all: HashMap<String, Vec<[f32; 3]>> = HashMap::new();
        for header in headers {
            all.entry(header.camera.clone()).or_default().push(header.white_balance);
        }
        Self(all.into_iter().map(|(camera, balances)| (camera, median(&balances))).collect())
    }

    /// That of the camera of a raw file.
    pub(super) fn of_camera(&self, header: &RawHeader) -> Option<[f32; 3]> {
        self.0.get(&header.camera).copied()
    }
}

fn median(balances: &[[f32; 3]]) -> [f32; 3] {
    [0, 1, 2].map(|channel| {
        let mut values: Vec<f32> = balances.iter().map(|balance| balance[channel]).collect();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_camera_has_the_median_of_its_own() {
        let header = |camera: &str, red: f32| RawHeader {
            camera: camera.to_owned(),
            white_balance: [red, 1.0, 1.5],
            reader: None,
        };
        let headers = [2.0, 1.0, 1.8].map(|red| header("a", red));
        let other = header("b", 3.0);
        let balances = WhiteBalances::of(headers.iter().chain([&other]));
        assert_eq!(balances.of_camera(&headers[0]), Some([1.8, 1.0, 1.5]));
        assert_eq!(balances.of_camera(&other), Some([3.0, 1.0, 1.5]));
        assert_eq!(balances.of_camera(&header("c", 1.0)), None);
    }
}
