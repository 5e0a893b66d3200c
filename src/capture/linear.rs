//! Small systems of linear equations.

/// Solves `A x = b` by Cholesky, with A given by its lower half; `None` unless it is positive
/// definite.
pub fn solve<const N: usize>(lower: [[f64; N]; N], mut right: [f64; N]) -> Option<[f64; N]> {
    let mut factor = lower;
    for i in 0..N {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
            let rest = lower[i][j] - sum;
            if i != j {
                factor[i][j] = rest / factor[j][j];
            } else if rest.is_finite() && rest > 0.0 {
                factor[i][i] = rest.sqrt();
            } else {
                return None;
            }
        }
    }
    for i in 0..N {
        let sum: f64 = (0..i).map(|k| factor[i][k] * right[k]).sum();
        right[i] = (right[i] - sum) / factor[i][i];
    }
    for i in (0..N).rev() {
        let sum: f64 = (i + 1..N).map(|k| factor[k][i] * right[k]).sum();
        right[i] = (right[i] - sum) / factor[i][i];
    }
    right.iter().all(|x| x.is_finite()).then_some(right)
}

#[cfg(test)]
mod tests {
    use super::solve;

    #[test]
    fn a_definite_system_is_solved_and_others_are_not() {
        let solved = solve([[4.0, 0.0], [2.0, 3.0]], [10.0, 8.0]).expect("positive definite");
        assert!((solved[0] - 1.75).abs() < 1e-12 && (solved[1] - 1.5).abs() < 1e-12);
        assert_eq!(solve([[1.0, 0.0], [1.0, 1.0]], [1.0, 1.0]), None);
        assert_eq!(solve([[f64::NAN]], [1.0]), None);
    }
}
