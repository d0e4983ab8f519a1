//! The estimate of mutual information from neighbours, and its input: plain tensors. Independent of episodes.

use tch::{Kind, Tensor};

use crate::batch::{int, values};

/// Numbers of neighbours over which the estimate is averaged.
const NEIGHBOURS: [i64; 3] = [5, 6, 7];
/// Principal components of a state.
const STATE: i64 = 16;
/// Share of the steps at each end whose scores are clipped.
const CLIPPED: f64 = 0.01;
/// Components with less than this share of the largest variance are noise.
const NOISE: f32 = 1e-6;
/// A deviation below this share of a column's size is rounding.
const CONSTANT: f64 = 1e-6;

/// The first principal components of standardised columns, each with variance 1: of parts `[T, D]` of N rows in all, to
/// `[N, ≤ 16]`. Only one part at a time is held in double.
pub(super) fn whitened(parts: &[Tensor]) -> Tensor {
    let rows: i64 = parts.iter().map(|part| part.size()[0]).sum();
    #[expect(clippy::cast_precision_loss, reason = "far fewer steps than 2^52")]
    let rows = rows.max(1) as f64;
    let double = |part: &Tensor| part.to_kind(Kind::Double);
    let mean =
        parts.iter().map(|part| double(part).sum_dim_intlist([0i64].as_slice(), true, None)).sum::<Tensor>() / rows;
    let product = |part: &Tensor| {
        let centred = double(part) - &mean;
        centred.tr().matmul(&centred)
    };
    let covariance = parts.iter().map(product).sum::<Tensor>() / rows;
    let deviation = covariance.diag(0).clamp_min(0.0).sqrt().unsqueeze(0);
    // A column that varies by rounding alone is constant.
    let noise = (mean.abs() + 1.0) * CONSTANT;
    let deviation = deviation.where_self(&deviation.gt_tensor(&noise), &deviation.ones_like());
    let (variances, directions) = (covariance / deviation.tr().matmul(&deviation)).linalg_eigh("L");
    let (variances, directions) = (variances.flip([0i64]), directions.flip([1i64]));
    let all = values(&variances.to_kind(Kind::Float));
    let least = all.first().copied().unwrap_or(0.0) * NOISE;
    let kept = int(all.iter().take_while(|variance| **variance > least).count()).clamp(1, STATE);
    let scale = variances.narrow(0, 0, kept).clamp_min(1e-24).sqrt();
    let directions = directions.narrow(1, 0, kept) / scale;
    let project = |part: &Tensor| ((double(part) - &mean) / &deviation).matmul(&directions).to_kind(Kind::Float);
    Tensor::cat(&parts.iter().map(project).collect::<Vec<_>>(), 0)
}

/// −mean over k of ψ(n_s) + ψ(n_a), `[N]`, for states `[N, S]` and actions `[N, A]`.
pub(super) fn estimate(state: &Tensor, action: &Tensor) -> Tensor {
    let apart = |points: &Tensor| Tensor::cdist(points, points, 2.0, Some(2));
    let (states, actions) = (apart(state), apart(action));
    let count = state.size()[0];
    // A step's own distance, 0, is the first.
    let most = NEIGHBOURS[NEIGHBOURS.len() - 1].min(count - 1);
    let (nearest, _) = states.maximum(&actions).topk(most + 1, 1, false, true);
    let digamma = digamma(usize::try_from(count).unwrap_or(0)).to_device(state.device());
    let mut sum = Tensor::zeros([count], (Kind::Float, state.device()));
    for k in NEIGHBOURS {
        let radius = nearest.narrow(1, k.min(most), 1);
        for distances in [&states, &actions] {
            // Equal steps have radius 0 and count only themselves.
            let nearer = distances.lt_tensor(&radius).sum_dim_intlist([1i64].as_slice(), false, Kind::Int64);
            sum -= digamma.index_select(0, &nearer.clamp_min(1));
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "three")]
    let numbers = NEIGHBOURS.len() as f64;
    sum / numbers
}

/// ψ(n) of the whole numbers up to `count`, `[count + 1]`: the harmonic number of n − 1, less Euler's constant. ψ(0) is
/// unused.
fn digamma(count: usize) -> Tensor {
    const EULER: f64 = 0.577_215_664_901_532_9;
    let mut harmonic = -EULER;
    let mut all = vec![f32::NAN];
    for n in 1..=count {
        #[expect(clippy::cast_possible_truncation, reason = "as exact as a score needs")]
        all.push(harmonic as f32);
        #[expect(clippy::cast_precision_loss, reason = "at most a few thousand")]
        let n = n as f64;
        harmonic += 1.0 / n;
    }
    Tensor::from_slice(&all)
}

/// Scores clipped at both ends, with mean 0 and deviation 1; zeros if all are equal.
pub(super) fn standardised(mut scores: Vec<f64>) -> Vec<f64> {
    let mut sorted = scores.clone();
    sorted.sort_by(f64::total_cmp);
    #[expect(clippy::cast_precision_loss, reason = "far fewer steps than 2^52")]
    let count = sorted.len() as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in the list")]
    let clipped = (count * CLIPPED) as usize;
    let (Some(lo), Some(hi)) = (sorted.get(clipped), sorted.iter().rev().nth(clipped)) else { return scores };
    scores.iter_mut().for_each(|score| *score = score.clamp(*lo, *hi));
    let mean = scores.iter().sum::<f64>() / count;
    let deviation = (scores.iter().map(|score| (score - mean).powi(2)).sum::<f64>() / count).sqrt();
    let scale = if deviation > 1e-12 { deviation } else { 1.0 };
    scores.into_iter().map(|score| (score - mean) / scale).collect()
}

/// The mean of the last `window` steps, or of those that there are, at every step.
pub(super) fn windows(steps: &[f64], window: usize) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "a window")]
    let mean = |steps: &[f64]| steps.iter().sum::<f64>() / steps.len() as f64;
    (0..steps.len()).map(|last| mean(&steps[(last + 1).saturating_sub(window)..=last])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, generator, normal};

    /// Two normal numbers of correlation c have the information −ln(1 − c²) / 2: 0, 0.830, 1.959.
    #[test]
    fn the_estimate_is_the_information_of_correlated_numbers() {
        for (correlation, expected) in [(0.0f32, 0.002), (0.9, 0.859), (0.99, 1.989)] {
            let drawn = normal(&mut generator(4, Purpose::Style, 0), 2000);
            let state: Vec<f32> = drawn.iter().step_by(2).copied().collect();
            let rest = (1.0 - correlation * correlation).sqrt();
            let action: Vec<f32> = drawn.chunks(2).map(|pair| correlation * pair[0] + rest * pair[1]).collect();
            let column = |values: &[f32]| Tensor::from_slice(values).view([-1, 1]);
            let mean = estimate(&column(&state), &column(&action)).mean(Kind::Double).double_value(&[]);
            let digamma = values(&digamma(1000));
            let of_k = NEIGHBOURS.map(|k| f64::from(digamma[usize::try_from(k).unwrap()])).iter().sum::<f64>() / 3.0;
            let found = mean + of_k + f64::from(digamma[1000]);
            assert!((found - expected).abs() < 0.06, "{correlation}: {found}");
        }
    }

    #[test]
    fn equal_steps_have_finite_equal_scores() {
        let equal = Tensor::ones([20, 2], (Kind::Float, tch::Device::Cpu));
        let found = values(&estimate(&equal, &equal));
        // −(ψ(1) + ψ(1)).
        assert!(found.iter().all(|score| (score - 2.0 * 0.577_215_7).abs() < 1e-5), "{found:?}");
        assert_eq!(standardised(vec![3.0; 9]), vec![0.0; 9]);
    }

    #[test]
    fn scores_are_clipped_standardised_and_averaged_over_windows() {
        let mut wild: Vec<f64> = (0..1000).map(f64::from).collect();
        wild[0] = -1e9;
        let even = standardised(wild);
        let mean = even.iter().sum::<f64>() / 1000.0;
        assert!(mean.abs() < 1e-9 && even.iter().all(|score| score.abs() < 2.0));
        assert_eq!(windows(&[1.0, 3.0, 5.0, 7.0], 2), [1.0, 2.0, 4.0, 6.0]);
    }

    #[test]
    fn components_are_uncorrelated_and_constant_columns_are_left_out() {
        let drawn = normal(&mut generator(2, Purpose::Style, 0), 600);
        let rows: Vec<f32> =
            drawn.chunks(2).flat_map(|pair| [pair[0], pair[0] + pair[1], 5.0 + 4e-7 * pair[1]]).collect();
        let rows = Tensor::from_slice(&rows).view([-1, 3]);
        let components = whitened(&[rows.narrow(0, 0, 100), rows.narrow(0, 100, 200)]);
        assert_eq!(components.size()[1], 2);
        let covariance = values(&(components.tr().matmul(&components) / 300.0));
        for (found, expected) in covariance.iter().zip([1.0, 0.0, 0.0, 1.0]) {
            assert!((found - expected).abs() < 1e-3, "{covariance:?}");
        }
    }
}
