use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;

#[test]
fn every_number_has_a_near_value_even_a_rare_one() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut numbers: Vec<f32> = (0..5000).map(|_| random.random_range(-1.0..1.0)).collect();
    numbers.extend([-9.0, 5.0, 7.0]);
    let book = Codebook::of(numbers.clone());
    assert!(book.values().is_sorted());
    let error = |number: &f32| (book.values()[usize::from(book.index(*number))] - number).abs();
    let errors: Vec<f32> = numbers.iter().map(error).collect();
    // Equal steps would have 16 / 255 between values.
    assert!(errors.iter().all(|error| *error < 0.04), "{errors:?}");
    let mean = errors.iter().sum::<f32>() / errors.len() as f32;
    assert!(mean < 0.005, "{mean}");
    let nearest = |number: f32| {
        book.values().iter().map(|value| (value - number).abs()).fold(f32::MAX, f32::min)
    };
    assert!(numbers.iter().zip(&errors).all(|(number, error)| *error == nearest(*number)));
}

#[test]
fn few_numbers_are_kept_and_none_make_a_codebook_too() {
    let book = Codebook::of(vec![2.0, -1.0, 2.0, 0.5]);
    for number in [2.0, -1.0, 0.5] {
        assert_eq!(book.values()[usize::from(book.index(number))], number);
    }
    assert_eq!(Codebook::of(vec![3.0]).values(), [3.0; VALUES]);
    assert_eq!(Codebook::of(Vec::new()).values(), [0.0; VALUES]);
}

#[test]
fn a_palette_groups_what_is_alike_and_keeps_what_fits() {
    let centres = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [-9.0, 9.0]];
    let vectors: Vec<[f32; 2]> =
        (0..200).map(|n| centres[n % 4].map(|v| v + (n / 4) as f32 * 1e-3)).collect();
    let rows: Vec<&[f32]> = vectors.iter().map(|vector| &vector[..]).collect();
    let palette = Palette::of(&rows, 4);
    assert_eq!(palette.entries.len(), 4);
    for (row, &label) in rows.iter().zip(&palette.labels) {
        let entry = &palette.entries[usize::from(label)];
        assert!((0..2).all(|axis| (entry[axis] - row[axis]).abs() < 0.05), "{row:?} {entry:?}");
    }
    let all = Palette::of(&rows[..50], 64);
    assert_eq!(all.entries.len(), 50);
    let entry = |n: usize| &all.entries[usize::from(all.labels[n])][..];
    assert!((0..50).all(|n| entry(n) == rows[n]));
    let same = Palette::of(&[&[1.0, 2.0][..]; 7], 4);
    assert_eq!((same.entries, same.labels), (vec![vec![1.0, 2.0]], vec![0; 7]));
}
