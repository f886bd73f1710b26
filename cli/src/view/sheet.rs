//! The sheet on which tiles are put together: captions, text, and the PNG file.

use super::lettering;
use super::picture::{CAPTION, PictureError, TILE, Tile};

const CAPTION_GROUND: [f32; 3] = [0.018, 0.023, 0.031];
const TEXT: [f32; 3] = [0.86, 0.89, 0.93];
const QUIET_TEXT: [f32; 3] = [0.36, 0.41, 0.48];

/// The whole picture, linear colours.
pub(super) struct Sheet {
    width: usize,
    height: usize,
    pixels: Vec<[f32; 3]>,
}

impl Sheet {
    /// An empty sheet of this size, pixels.
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![[0.004, 0.005, 0.007]; width * height] }
    }

    /// Puts a tile with its upper left corner at (left, top).
    pub(super) fn place(&mut self, tile: &Tile, left: usize, top: usize) {
        for y in 0..TILE[1] + CAPTION {
            for x in 0..TILE[0] {
                let pixel = if y < TILE[1] {
                    tile.pixels[y * TILE[0] + x]
                } else if y < TILE[1] + 4 {
                    tile.color
                } else {
                    CAPTION_GROUND
                };
                self.pixels[(top + y) * self.width + left + x] = pixel;
            }
        }
        let (x, y) = ((left + 12) as f64, (top + TILE[1]) as f64);
        let right = (left + TILE[0] - 12) as f64;
        self.text(&tile.title, [x, y + 28.0], 16.0, TEXT);
        self.text(&tile.detail, [x, y + 46.0], 11.0, QUIET_TEXT);
        if !tile.figure.is_empty() {
            let number = tile.figure.starts_with(|c: char| c.is_ascii_digit());
            let size = if number { 24.0 } else { 16.0 };
            let left = right - lettering::width(&tile.figure) * size;
            self.text(&tile.figure, [left, y + 42.0], size, TEXT);
            if number {
                self.text(
                    "score",
                    [left - lettering::width("score ") * 11.0 - 4.0, y + 42.0],
                    11.0,
                    QUIET_TEXT,
                );
            }
        }
    }

    fn text(&mut self, text: &str, origin: [f64; 2], height: f64, color: [f32; 3]) {
        let (width, total) = (self.width as i64, self.height as i64);
        let pixels = &mut self.pixels;
        lettering::draw(text, origin, height, |x, y, coverage| {
            if x >= 0 && y >= 0 && x < width && y < total {
                let pixel = &mut pixels[(y * width + x) as usize];
                *pixel = [0, 1, 2].map(|k| pixel[k] + (color[k] - pixel[k]) * coverage);
            }
        });
    }

    /// The sheet as a PNG file.
    ///
    /// # Errors
    /// If it cannot be encoded.
    pub(super) fn to_png(&self) -> Result<Vec<u8>, PictureError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        let data: Vec<u8> = self.pixels.iter().flatten().map(|&c| srgb(c)).collect();
        writer.write_image_data(&data)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// A linear intensity as an sRGB byte.
fn srgb(linear: f32) -> u8 {
    let c = linear.clamp(0.0, 1.0);
    let encoded = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_light_is_encoded_as_srgb() {
        assert_eq!([0.0, 0.25, 1.0, 2.0].map(srgb), [0, 137, 255, 255]);
    }

    #[test]
    fn a_tile_lands_where_it_is_put() {
        let tile = Tile {
            pixels: vec![[1.0, 0.0, 0.0]; TILE[0] * TILE[1]],
            title: "hand".into(),
            figure: "0.50".into(),
            detail: String::new(),
            color: [0.0, 1.0, 0.0],
        };
        let mut sheet = Sheet::new(TILE[0] + 20, TILE[1] + CAPTION + 20);
        sheet.place(&tile, 10, 10);
        let at = |x: usize, y: usize| sheet.pixels[y * sheet.width + x];
        assert_eq!(at(10, 10), [1.0, 0.0, 0.0]);
        assert_ne!(at(9, 10), [1.0, 0.0, 0.0]);
        assert_eq!(at(10, 10 + TILE[1]), [0.0, 1.0, 0.0]);
        let bright = sheet.pixels.iter().filter(|p| p[0] > 0.5 && p[1] > 0.5).count();
        assert!(bright > 100, "title and figure are written: {bright}");
    }
}
