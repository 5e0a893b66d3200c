//! A furnished room at dusk, for demonstrations. All of it is modelled here; y points down, the
//! floor is at 1.4, a unit is about a metre.

mod builder;
mod corners;
mod library;
mod seats;
mod walls;

use glam::DVec3;

use super::paint::Paint;
use super::room::{Group, Lamp, Room};
use super::shape::Shape;
use builder::Builder;

/// The room. It is always the same: a seed changes only path and shake.
pub(super) fn study() -> Room {
    let mut builder = Builder::new();
    let walls =
        Shape::Walls { centre: DVec3::new(0.0, -0.2, -0.7), half: DVec3::new(3.4, 1.6, 3.6) };
    let walls = vec![builder.solid(walls, Paint::Walls, [0.5; 3])];
    let mut groups = vec![Group::everywhere(walls)];
    type Piece = fn(&mut Builder);
    let pieces: [Piece; 11] = [
        seats::rug,
        library::shelf,
        library::books,
        walls::window,
        corners::cabinet,
        seats::armchair,
        seats::table,
        corners::floor_lamp,
        corners::plant,
        walls::pictures,
        seats::toys,
    ];
    for piece in pieces {
        piece(&mut builder);
        groups.push(Group::around(std::mem::take(&mut builder.solids)));
    }
    Room {
        groups,
        lamps: lamps(),
        ambient: DVec3::new(0.115, 0.12, 0.15),
        scale: 0.35,
        wallpapers: Vec::new(),
    }
}

/// The lamp beside the chair, the one on the cabinet, a ceiling lamp behind the photographer, and
/// the light from the window.
fn lamps() -> Vec<Lamp> {
    let lamp = |place: [f64; 3], colour: [f64; 3], white_at: f64| Lamp {
        place: DVec3::from(place),
        colour: DVec3::from(colour),
        white_at,
    };
    vec![
        lamp([-2.25, -0.42, 1.0], [1.0, 0.74, 0.46], 1.3),
        lamp([2.35, 0.16, 2.5], [1.0, 0.7, 0.4], 0.5),
        lamp([0.6, -1.6, -1.9], [1.0, 0.86, 0.68], 2.3),
        lamp([1.55, -0.6, 2.6], [0.55, 0.62, 1.0], 0.75),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::room::Solid;
    use super::*;

    #[test]
    fn the_study_is_always_the_same_and_within_its_walls() {
        let (one, other) = (study(), study());
        let solids = |room: &Room| -> Vec<Solid> {
            room.groups.iter().flat_map(Group::solids).copied().collect()
        };
        assert_eq!(format!("{:?}", solids(&one)), format!("{:?}", solids(&other)));
        let inside = solids(&one).split_off(1);
        assert!(inside.len() > 150, "{} solids", inside.len());
        for solid in &inside {
            let centre = solid.shape.centre();
            assert!(centre.x.abs() < 3.4 && centre.y < 1.4 && centre.y > -1.8, "{solid:?}");
            assert!(centre.z < 2.9 && centre.z > -4.3, "{solid:?}");
        }
    }
}
