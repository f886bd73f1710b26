//! The picture of `graspd eval contacts`, laid out like Supplementary Fig. 1: a row for each view, a column for the labels
//! and for each network, below it what was measured.

use base64::Engine as _;
use graspd_sim::render::RgbImage;
use graspd_training::evaluate::contacts::ContactRow;
use graspd_training::evaluate::svg::escaped;

use crate::commands::eval::png;

/// Size of a voxel's column in the picture.
const SCALE: usize = 2;
const GAP: usize = 10;
/// Room above and below the cells for words.
const WORDS: usize = 40;

/// A column of the picture.
pub(super) struct Column {
    /// Above it.
    pub(super) title: String,
    /// A second line above it.
    pub(super) what: String,
    /// Below it.
    pub(super) figures: String,
    /// A cell for each view.
    pub(super) cells: Vec<RgbImage>,
}

impl Column {
    /// The column of a network.
    pub(super) fn of(row: &ContactRow, cells: Vec<RgbImage>) -> Self {
        let s = &row.scores;
        let shown = |v: Option<f64>| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}"));
        let figures = format!("({}, {}, {})", shown(s.e_pc), shown(s.e_pe), shown(s.e_angle));
        Self { title: row.data_type.clone(), what: row.network.clone(), figures, cells }
    }
}

/// The picture as an SVG file.
///
/// # Errors
/// For a cell that cannot be encoded.
pub(super) fn svg(columns: &[Column]) -> anyhow::Result<String> {
    let cell = columns.iter().flat_map(|c| c.cells.first()).map(|i| (i.width, i.height)).next();
    let (width, height) = cell.map_or((0, 0), |(w, h)| (w * SCALE, h * SCALE));
    let rows = columns.iter().map(|c| c.cells.len()).max().unwrap_or(0);
    let (wide, high) = (GAP + columns.len() * (width + GAP), WORDS + GAP + rows * (height + GAP) + WORDS / 2);
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {wide} {high}\" font-family=\"sans-serif\" \
         font-size=\"13\" text-anchor=\"middle\">\n<rect width=\"{wide}\" height=\"{high}\" fill=\"#0e1116\"/>\n"
    );
    for (i, column) in columns.iter().enumerate() {
        let left = GAP + i * (width + GAP);
        let mut words = |y: usize, color: &str, text: &str| {
            let x = left + width / 2;
            out += &format!("<text x=\"{x}\" y=\"{y}\" fill=\"{color}\">{}</text>\n", escaped(text));
        };
        words(20, "#fff", &column.title);
        words(38, "#9ab", &column.what);
        words(high - 8, "#fff", &column.figures);
        for (row, image) in column.cells.iter().enumerate() {
            let top = WORDS + GAP + row * (height + GAP);
            let bytes = base64::engine::general_purpose::STANDARD.encode(png(image)?);
            out += &format!(
                "<image x=\"{left}\" y=\"{top}\" width=\"{width}\" height=\"{height}\" \
                 style=\"image-rendering:pixelated\" href=\"data:image/png;base64,{bytes}\"/>\n"
            );
        }
    }
    Ok(out + "</svg>\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cell_of_every_column_is_in_the_picture_and_names_are_escaped() {
        let image = || RgbImage { width: 4, height: 2, pixels: vec![[9, 8, 7]; 8] };
        let column = |title: &str, cells: usize| Column {
            title: title.to_owned(),
            what: "a <network>".to_owned(),
            figures: "(1, 1, 1)".to_owned(),
            cells: (0..cells).map(|_| image()).collect(),
        };
        let drawn = svg(&[column("labels", 3), column("TSDF-R6D", 3)]).unwrap();
        assert_eq!(drawn.matches("<image ").count(), 6);
        assert!(drawn.contains("a &lt;network&gt;") && !drawn.contains("<network>"));
        assert!(svg(&[]).unwrap().ends_with("</svg>\n"));
    }
}
