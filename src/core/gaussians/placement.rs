//! Where an export lies in the programs that open it.

use glam::DVec3;
use serde_json::{Value, json};

use crate::camera::normalisation::Normalisation;

/// From the world of the poses to that of an export.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Units of the export per unit of the poses' world.
    pub scale: f64,
}

impl Default for Placement {
    fn default() -> Self {
        Self { scale: 1.0 }
    }
}

impl Placement {
    /// The node of a file whose coordinates are in the world of the poses without the offset that
    /// `f32` cannot represent, and turned so that y points up.
    pub(crate) fn node(&self, normalisation: &Normalisation) -> Node {
        let DVec3 { x, y, z } = normalisation.missing_in_files();
        Node { translation: self.scale * DVec3::new(x, -y, -z), scale: self.scale }
    }
}

/// The transform of a node; first it scales.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Node {
    /// Units of the export.
    pub translation: DVec3,
    /// Of all lengths.
    pub scale: f64,
}

impl Node {
    /// Whether it translates.
    pub fn translates(&self) -> bool {
        self.translation != DVec3::ZERO
    }

    /// Adds what is not the identity to a glTF node.
    pub fn add_to(&self, node: &mut Value) {
        if self.translates() {
            node["translation"] = json!(self.translation.to_array());
        }
        if self.scale != 1.0 {
            node["scale"] = [self.scale; 3].into();
        }
    }
}
