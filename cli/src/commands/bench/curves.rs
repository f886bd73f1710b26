//! How time grows, as a picture: one SVG panel each for batch, iterations and focal contacts.

use std::fmt::Write as _;

use super::stats::Times;

/// Panel width and height, pixels.
const PANEL: (f64, f64) = (300.0, 220.0);
/// Room around a panel's axes: left, top, right, bottom.
const MARGIN: (f64, f64, f64, f64) = (52.0, 34.0, 14.0, 44.0);

/// What is drawn: the prefix of the measurements' names, and what the number behind it counts.
const PANELS: [(&str, &str); 3] = [
    ("scaling.batch.", "candidates in the batch"),
    ("scaling.iterations.", "iterations"),
    ("scaling.focal-contacts.", "focal contacts N_fc"),
];

/// The SVG, or `None` when none of the curves was measured.
pub(super) fn svg(results: &[(String, Times)], subtitle: &str) -> Option<String> {
    let panels: Vec<(&str, Vec<(f64, f64)>)> = PANELS
        .iter()
        .map(|&(prefix, label)| (label, points(results, prefix)))
        .filter(|(_, points)| points.len() >= 2)
        .collect();
    if panels.is_empty() {
        return None;
    }
    let (width, height) = (PANEL.0 * panels.len() as f64, PANEL.1 + 24.0);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"sans-serif\" font-size=\"11\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
    );
    for (i, (label, points)) in panels.iter().enumerate() {
        panel(&mut out, PANEL.0 * i as f64, label, points);
    }
    let subtitle = subtitle.replace('&', "&amp;").replace('<', "&lt;");
    writeln!(out, "<text x=\"12\" y=\"{}\" fill=\"#666\">{subtitle}</text>\n</svg>", PANEL.1 + 14.0).ok();
    Some(out)
}

/// (number in the name, median ms) of all measurements with a prefix, sorted.
fn points(results: &[(String, Times)], prefix: &str) -> Vec<(f64, f64)> {
    let mut points: Vec<(f64, f64)> = results
        .iter()
        .filter_map(|(name, t)| Some((name.strip_prefix(prefix)?.parse().ok()?, t.median_ms)))
        .collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

fn panel(out: &mut String, left: f64, label: &str, points: &[(f64, f64)]) {
    let top_of = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).fold(0.0, f64::max);
    let (most_x, most_y) = (top_of(|p| p.0), nice(top_of(|p| p.1)));
    let (x0, y0) = (left + MARGIN.0, MARGIN.1);
    let (w, h) = (PANEL.0 - MARGIN.0 - MARGIN.2, PANEL.1 - MARGIN.1 - MARGIN.3);
    let at = |p: &(f64, f64)| (x0 + w * p.0 / most_x, y0 + h * (1.0 - p.1 / most_y));
    writeln!(out, "<text x=\"{x0}\" y=\"20\" font-weight=\"bold\">ms over {label}</text>").ok();
    for k in 0..=4 {
        let value = most_y * f64::from(k) / 4.0;
        let y = y0 + h * (1.0 - f64::from(k) / 4.0);
        writeln!(
            out,
            "<path d=\"M{x0} {y:.1}h{w}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" \
             text-anchor=\"end\" fill=\"#444\">{value:.0}</text>",
            x0 - 6.0,
            y + 4.0
        )
        .ok();
    }
    let line: Vec<String> = points.iter().map(at).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    writeln!(
        out,
        "<polyline points=\"{}\" fill=\"none\" stroke=\"#0b5cad\" stroke-width=\"2\"/>",
        line.join(" ")
    )
    .ok();
    let mut labelled = f64::NEG_INFINITY;
    for p in points {
        let (x, y) = at(p);
        writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.5\" fill=\"#0b5cad\"/>").ok();
        // Numbers under the axis that would run into each other are left out.
        if x - labelled > 34.0 {
            labelled = x;
            let below = y0 + h + 16.0;
            writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{below:.1}\" text-anchor=\"middle\" fill=\"#444\">{}</text>",
                p.0
            )
            .ok();
        }
    }
}

/// The next number of the form 1, 2, 4, 5, 8 × 10ⁿ that is not smaller.
fn nice(value: f64) -> f64 {
    let scale = 10f64.powf(value.max(1e-9).log10().floor());
    [1.0, 2.0, 4.0, 5.0, 8.0, 10.0].into_iter().map(|m| m * scale).find(|v| *v >= value).unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(median_ms: f64) -> Times {
        Times { median_ms, p95_ms: median_ms, count: 1 }
    }

    #[test]
    fn every_measured_curve_is_a_panel() {
        let results = vec![
            ("scaling.batch.48".into(), times(20.0)),
            ("scaling.batch.12".into(), times(5.0)),
            ("scaling.focal-contacts.317".into(), times(18.0)),
            ("scaling.focal-contacts.14000".into(), times(19.0)),
            ("refine".into(), times(12.0)),
        ];
        let svg = svg(&results, "2 < 3 threads").unwrap();
        assert_eq!(svg.matches("<polyline").count(), 2);
        assert_eq!(svg.matches("<circle").count(), 4);
        assert!(svg.contains("2 &lt; 3") && svg.ends_with("</svg>\n"));
    }

    #[test]
    fn nothing_measured_is_no_picture() {
        assert_eq!(svg(&[("refine".into(), times(12.0))], ""), None);
    }

    #[test]
    fn axes_end_at_round_numbers() {
        assert_eq!([nice(3.2), nice(17.0), nice(41.0), nice(100.0)], [4.0, 20.0, 50.0, 100.0]);
    }
}
