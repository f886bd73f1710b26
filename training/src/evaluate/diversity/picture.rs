//! Pictures of diversity as SVG: where touching pads were about the hand (Supplementary Fig. 3) and in which directions
//! they pointed (Supplementary Fig. 4).

use std::fmt::Write as _;

use graspd_hands::Hand;
use nalgebra::{Unit, Vector3};

use super::pattern::{Pattern, Touch, outline};
use super::run::HandPatterns;
use crate::evaluate::svg::escaped;

/// Side of a panel, pixels.
const SIDE: f64 = 230.0;
/// Room around panels, pixels.
const GAP: f64 = 26.0;
/// Touches that are drawn in a panel at most; of more, every so manieth.
const MOST_DOTS: usize = 400;
/// One for each finger; readable on light and dark ground.
const COLOURS: [&str; 5] = ["#3b82c4", "#d97706", "#7c8a3a", "#b5499b", "#c0504d"];

/// The hand seen from two sides: across the direction that its touches spread in most, and along it. Up is against the
/// approach.
struct Sides {
    up: Vector3<f64>,
    across: [Vector3<f64>; 2],
}

impl Sides {
    fn of(hand: &Hand, touches: &[&Touch]) -> Self {
        let up = -hand.approach.into_inner();
        let mut spread = nalgebra::Matrix3::zeros();
        let mean =
            touches.iter().map(|t| Vector3::from(t.at)).sum::<Vector3<f64>>() / touches.len().max(1) as f64;
        for touch in touches {
            let from_mean = Vector3::from(touch.at) - mean;
            let level = from_mean - up * up.dot(&from_mean);
            spread += level * level.transpose();
        }
        let eigen = spread.symmetric_eigen();
        let widest = Vector3::from(eigen.eigenvectors.column(eigen.eigenvalues.imax()));
        let level = widest - up * up.dot(&widest);
        let some = if up.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let first = Unit::try_new(level, 1e-9).map_or_else(|| up.cross(&some).normalize(), Unit::into_inner);
        Self { up, across: [first, up.cross(&first)] }
    }
}

fn all_touches(patterns: &[Pattern]) -> Vec<&Touch> {
    patterns.iter().flat_map(|p| &p.touches).collect()
}

/// At most [`MOST_DOTS`] of them, evenly taken.
fn some_of<'a>(touches: &[&'a Touch]) -> Vec<&'a Touch> {
    let step = touches.len().div_ceil(MOST_DOTS).max(1);
    touches.iter().step_by(step).copied().collect()
}

fn colour(finger: usize) -> &'static str {
    COLOURS[finger % COLOURS.len()]
}

/// Where touching pads were, hand frame: one row for each hand, two sides for each source.
pub fn reach_svg(measured: &[HandPatterns]) -> String {
    let columns = 2 * measured.iter().map(|m| m.sources.len()).max().unwrap_or(0);
    let mut out = head(columns, measured.len());
    for (row, hand) in measured.iter().enumerate() {
        let (spheres, every) = (outline(&hand.hand), hand.sources.iter().flat_map(|s| all_touches(&s.1)));
        let sides = Sides::of(&hand.hand, &every.collect::<Vec<_>>());
        let radius = spheres.iter().map(|(c, r)| c.coords.norm() + r).fold(0.05, f64::max);
        let middle =
            spheres.iter().map(|(c, _)| c.coords).sum::<Vector3<f64>>() / spheres.len().max(1) as f64;
        let scale = 0.5 * SIDE / radius.min(0.2);
        for (column, (source, patterns)) in hand.sources.iter().enumerate() {
            for (side, across) in sides.across.iter().enumerate() {
                let (left, top) = corner(2 * column + side, row);
                let at = |p: &Vector3<f64>| {
                    let from = p - middle;
                    let x = left + 0.5 * SIDE + scale * across.dot(&from);
                    (x, top + 0.5 * SIDE - scale * sides.up.dot(&from))
                };
                panel(&mut out, left, top);
                for (center, radius) in &spheres {
                    let (x, y) = at(&center.coords);
                    let r = radius * scale;
                    if inside(left, x, r) && inside(top, y, r) {
                        let _ = writeln!(
                            out,
                            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\" fill=\"#808080\" opacity=\"0.12\"/>"
                        );
                    }
                }
                let seen = some_of(&all_touches(patterns)).into_iter().filter_map(|touch| {
                    let (x, y) = at(&Vector3::from(touch.at));
                    (inside(left, x, 0.0) && inside(top, y, 0.0)).then_some((touch.finger, x, y))
                });
                dots(&mut out, seen.collect());
                if side == 0 {
                    title(&mut out, left, top, &format!("{}: {source}", hand.hand.display_name));
                }
            }
        }
        legend(&mut out, row, &hand.hand);
    }
    out + "</svg>\n"
}

/// In which directions touching pads pointed, hand frame, equal areas for equal shares of the sphere: the half around
/// the approach, and the half against it.
pub fn directions_svg(measured: &[HandPatterns]) -> String {
    let columns = 2 * measured.iter().map(|m| m.sources.len()).max().unwrap_or(0);
    let mut out = head(columns, measured.len());
    for (row, hand) in measured.iter().enumerate() {
        let every: Vec<&Touch> = hand.sources.iter().flat_map(|s| all_touches(&s.1)).collect();
        let sides = Sides::of(&hand.hand, &every);
        for (column, (source, patterns)) in hand.sources.iter().enumerate() {
            for (half, pole) in [-sides.up, sides.up].into_iter().enumerate() {
                let (left, top) = corner(2 * column + half, row);
                let (x, y, r) = (left + 0.5 * SIDE, top + 0.5 * SIDE, 0.5 * SIDE - 4.0);
                let _ = writeln!(
                    out,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\" fill=\"none\" stroke=\"#808080\"/>\
                     <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
                    top + SIDE + 12.0,
                    ["along the approach", "against it"][half]
                );
                let seen = some_of(&all_touches(patterns)).into_iter().filter_map(|touch| {
                    let direction = Vector3::from(touch.direction);
                    let height = pole.dot(&direction);
                    // Lambert's azimuthal projection: the pole in the middle, the equator on the circle.
                    let out_by = (1.0 - height).max(0.0).sqrt();
                    let level = direction - pole * height;
                    let way = level.try_normalize(1e-9).unwrap_or_else(Vector3::zeros) * (out_by * r);
                    let at = (x + way.dot(&sides.across[0]), y - way.dot(&sides.across[1]));
                    (height >= 0.0).then_some((touch.finger, at.0, at.1))
                });
                dots(&mut out, seen.collect());
                if half == 0 {
                    title(&mut out, left, top, &format!("{}: {source}", hand.hand.display_name));
                }
            }
        }
        legend(&mut out, row, &hand.hand);
    }
    out + "</svg>\n"
}

fn head(columns: usize, rows: usize) -> String {
    let width = columns as f64 * (SIDE + GAP) + GAP;
    let height = rows as f64 * (SIDE + 3.0 * GAP) + GAP;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"12\" fill=\"#808080\">\n"
    )
}

fn corner(column: usize, row: usize) -> (f64, f64) {
    (GAP + column as f64 * (SIDE + GAP), GAP + 8.0 + row as f64 * (SIDE + 3.0 * GAP))
}

fn inside(edge: f64, at: f64, radius: f64) -> bool {
    at - radius >= edge && at + radius <= edge + SIDE
}

fn panel(out: &mut String, left: f64, top: f64) {
    let _ = writeln!(
        out,
        "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{SIDE}\" height=\"{SIDE}\" fill=\"none\" stroke=\"#808080\" \
         stroke-opacity=\"0.4\"/>"
    );
}

/// Dots at places of the picture, each in its finger's colour.
fn dots(out: &mut String, mut seen: Vec<(usize, f64, f64)>) {
    seen.sort_by_key(|(finger, ..)| *finger);
    for of_finger in seen.chunk_by(|a, b| a.0 == b.0) {
        let _ = writeln!(out, "<g fill=\"{}\" opacity=\"0.55\">", colour(of_finger[0].0));
        for (_, x, y) in of_finger {
            let _ = writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"1.6\"/>");
        }
        out.push_str("</g>\n");
    }
}

fn title(out: &mut String, left: f64, top: f64, text: &str) {
    let _ = writeln!(
        out,
        "<text x=\"{left:.1}\" y=\"{:.1}\" font-size=\"14\">{}</text>",
        top - 8.0,
        escaped(text)
    );
}

fn legend(out: &mut String, row: usize, hand: &Hand) {
    let (left, top) = corner(0, row);
    let y = top + SIDE + 32.0;
    for (i, finger) in hand.fingers.iter().enumerate() {
        let x = left + 110.0 * i as f64;
        let _ = writeln!(
            out,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"5\" fill=\"{}\"/><text x=\"{:.1}\" y=\"{y:.1}\">{}</text>",
            x + 5.0,
            y - 4.0,
            colour(i),
            x + 15.0,
            escaped(&finger.name)
        );
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use graspd_hands::library;

    use super::*;

    fn measured() -> Vec<HandPatterns> {
        let hand = Arc::new(library::hand("leap").unwrap().clone());
        let touch = |i: usize| {
            let angle = i as f64;
            Touch {
                pad: i % hand.pads.len(),
                finger: hand.pads[i % hand.pads.len()].finger,
                share: 1.0,
                at: [0.02 * angle.cos(), 0.01 * angle.sin(), 0.05],
                direction: [angle.cos(), angle.sin(), 0.0],
            }
        };
        let pattern = Pattern { scene: 0, area: 0.5, touches: (0..40).map(touch).collect() };
        vec![HandPatterns {
            hand,
            sources: vec![("a <b>".into(), vec![pattern.clone()]), ("c".into(), vec![pattern])],
        }]
    }

    #[test]
    fn every_direction_is_drawn_in_one_half_or_on_the_edge_of_both() {
        let measured = measured();
        let drawn = directions_svg(&measured);
        let dots = drawn.matches("r=\"1.6\"").count();
        assert!((80..=160).contains(&dots), "{dots}");
        assert!(drawn.contains("a &lt;b&gt;") && drawn.ends_with("</svg>\n") && !drawn.contains("NaN"));
    }

    #[test]
    fn touches_and_the_hand_are_drawn_with_the_approach_downwards() {
        let measured = measured();
        let drawn = reach_svg(&measured);
        assert!(!drawn.contains("NaN"));
        assert!(drawn.matches("opacity=\"0.12\"").count() > 4, "the hand is there");
        let sides = Sides::of(&measured[0].hand, &all_touches(&measured[0].sources[0].1));
        assert!((sides.up + measured[0].hand.approach.into_inner()).norm() < 1e-12);
        for across in sides.across {
            assert!(across.dot(&sides.up).abs() < 1e-9 && (across.norm() - 1.0).abs() < 1e-9);
        }
    }
}
