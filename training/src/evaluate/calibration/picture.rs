//! A reliability curve as an SVG: what was stated against what came true.

use std::fmt::Write as _;

use super::reliability::Reliability;
use crate::evaluate::svg::escaped;

/// Side of the square that the curve is drawn in, pixels.
const SIDE: f64 = 360.0;
/// Room for the axes' labels, pixels.
const MARGIN: f64 = 56.0;

/// Draws curves with their names over the diagonal of true probabilities; bars are 95 % intervals, the area of a dot
/// is the number of grasps. Colours read on light and dark ground.
pub fn svg(curves: &[(&str, &Reliability)]) -> String {
    const COLOURS: [&str; 3] = ["#3b82c4", "#d97706", "#7c8a3a"];
    let (width, height) = (SIDE + 2.0 * MARGIN + 150.0, SIDE + 2.0 * MARGIN);
    let x = |p: f64| MARGIN + p * SIDE;
    let y = |p: f64| MARGIN + (1.0 - p) * SIDE;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"13\" fill=\"#808080\">\n<rect x=\"{MARGIN}\" y=\"{MARGIN}\" width=\"{SIDE}\" height=\"{SIDE}\" \
         fill=\"none\" stroke=\"#808080\"/>\n<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" \
         stroke=\"#808080\" stroke-dasharray=\"4 4\"/>\n",
        x(0.0),
        y(0.0),
        x(1.0),
        y(1.0)
    );
    for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
        let _ = writeln!(
            out,
            "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{tick}</text>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{tick}</text>",
            x(tick),
            y(0.0) + 18.0,
            x(0.0) - 6.0,
            y(tick) + 4.0
        );
    }
    let _ = writeln!(
        out,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">stated probability</text>\
         <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" transform=\"rotate(-90 {:.1} {:.1})\">share that \
         held</text>",
        x(0.5),
        y(0.0) + 40.0,
        x(0.0) - 40.0,
        y(0.5),
        x(0.0) - 40.0,
        y(0.5)
    );
    for (i, (name, curve)) in curves.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        // Curves lie side by side, not over each other.
        let aside = 2.0 * i as f64;
        for bin in &curve.bins {
            let (at, radius) =
                (x(bin.stated) + aside, (bin.count as f64).sqrt().clamp(2.0, 40.0) / 3.0 + 1.0);
            let _ = writeln!(
                out,
                "<line x1=\"{at:.1}\" y1=\"{:.1}\" x2=\"{at:.1}\" y2=\"{:.1}\" stroke=\"{colour}\"/>\
                 <circle cx=\"{at:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\" fill=\"{colour}\"/>",
                y(bin.held.low),
                y(bin.held.high),
                y(bin.held.rate)
            );
        }
        let (left, top) = (x(1.0) + 16.0, MARGIN + 12.0 + 40.0 * i as f64);
        let _ = writeln!(
            out,
            "<circle cx=\"{left:.1}\" cy=\"{:.1}\" r=\"5\" fill=\"{colour}\"/><text x=\"{:.1}\" y=\"{top:.1}\">{}</text>\
             <text x=\"{:.1}\" y=\"{:.1}\">ECE {:.3}</text>",
            top - 4.0,
            left + 12.0,
            escaped(name),
            left + 12.0,
            top + 17.0,
            curve.error
        );
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::super::reliability::reliability;
    use super::*;

    #[test]
    fn every_bin_is_drawn_inside_the_picture() {
        let outcomes: Vec<(f64, bool)> = (0..100).map(|i| (f64::from(i) / 100.0, i % 3 == 0)).collect();
        let curve = reliability(&outcomes, 10);
        let drawn = svg(&[("own <curves>", &curve)]);
        assert_eq!(drawn.matches("<circle").count(), 11, "ten bins and the legend");
        assert!(drawn.contains("own &lt;curves&gt;") && drawn.ends_with("</svg>\n"));
        assert!(!drawn.contains("NaN") && !drawn.contains("inf"));
    }
}
