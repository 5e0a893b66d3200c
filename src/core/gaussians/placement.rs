//! Where an export lies in the programs that open it.

use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use crate::camera::normalisation::Normalisation;

/// From the world of the poses to that of an export.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Units of the export per unit of the poses' world.
    pub scale: f64,
    /// The unit vector of the poses' world that points up.
    pub up: DVec3,
}

impl Default for Placement {
    fn default() -> Self {
        Self { scale: 1.0, up: DVec3::NEG_Y }
    }
}

impl Placement {
    /// The node of a file whose coordinates are in the world of the poses without the offset that
    /// `f32` cannot represent, and turned by half a turn about x. With it, up is along y.
    pub(crate) fn node(&self, normalisation: &Normalisation) -> Node {
        let turned = |DVec3 { x, y, z }| DVec3::new(x, -y, -z);
        let rotation = DQuat::from_rotation_arc(turned(self.up), DVec3::Y);
        let offset = turned(normalisation.missing_in_files());
        Node { translation: self.scale * (rotation * offset), rotation, scale: self.scale }
    }
}

/// The transform of a node: it scales, rotates and translates, in this order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Node {
    /// Units of the export.
    pub translation: DVec3,
    /// A unit quaternion.
    pub rotation: DQuat,
    /// Of all lengths.
    pub scale: f64,
}

impl Node {
    /// Whether it translates.
    pub fn translates(&self) -> bool {
        self.translation != DVec3::ZERO
    }

    /// Whether it rotates.
    pub fn rotates(&self) -> bool {
        self.rotation != DQuat::IDENTITY
    }

    /// Adds what is not the identity to a glTF node.
    pub fn add_to(&self, node: &mut Value) {
        if self.translates() {
            node["translation"] = json!(self.translation.to_array());
        }
        if self.rotates() {
            node["rotation"] = json!(self.rotation.to_array());
        }
        if self.scale != 1.0 {
            node["scale"] = [self.scale; 3].into();
        }
    }
}
