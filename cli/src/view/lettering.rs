//! Letters made of strokes, for pictures: capitals, digits and a few signs; small letters are drawn as small
//! capitals.

/// Strokes on a grid 4 wide and 6 high: pairs of digits (x, then y upwards from the baseline), points
/// separated by blanks, strokes by `|`.
fn strokes(letter: char) -> &'static str {
    match letter {
        'A' => "00 26 40|12 32",
        'B' => "00 06 36 45 44 33 03|33 42 41 30 00",
        'C' => "45 36 16 05 01 10 30 41",
        'D' => "00 06 26 45 41 20 00",
        'E' => "46 06 00 40|03 33",
        'F' => "46 06 00|03 33",
        'G' => "45 36 16 05 01 10 30 41 43 23",
        'H' => "00 06|40 46|03 43",
        'I' => "20 26|10 30|16 36",
        'J' => "46 41 30 10 01",
        'K' => "00 06|46 03 40",
        'L' => "06 00 40",
        'M' => "00 06 23 46 40",
        'N' => "00 06 40 46",
        'O' => "10 30 41 45 36 16 05 01 10",
        'P' => "00 06 36 45 44 33 03",
        'Q' => "10 30 41 45 36 16 05 01 10|22 40",
        'R' => "00 06 36 45 44 33 03|23 40",
        'S' => "45 36 16 05 04 13 33 42 41 30 10 01",
        'T' => "06 46|26 20",
        'U' => "06 01 10 30 41 46",
        'V' => "06 20 46",
        'W' => "06 10 24 30 46",
        'X' => "00 46|06 40",
        'Y' => "06 23 46|23 20",
        'Z' => "06 46 00 40",
        '0' => "10 30 41 45 36 16 05 01 10|11 35",
        '1' => "14 26 20|10 30",
        '2' => "05 16 36 45 44 00 40",
        '3' => "05 16 36 45 44 33 42 41 30 10 01|13 33",
        '4' => "30 36 02 42",
        '5' => "46 06 03 33 42 41 30 10 01",
        '6' => "45 36 16 05 01 10 30 41 42 33 03",
        '7' => "06 46 10",
        '8' => "13 04 05 16 36 45 44 33 13 02 01 10 30 41 42 33",
        '9' => "01 10 30 41 45 36 16 05 04 13 43",
        '-' => "13 33",
        '.' => "20 20",
        ',' => "21 10",
        ':' => "21 21|24 24",
        '(' => "36 24 22 30",
        ')' => "16 24 22 10",
        '/' => "00 46",
        '%' => "00 46|05 16|30 41",
        '+' => "21 25|03 43",
        '=' => "02 42|04 44",
        '_' => "00 40",
        '<' => "45 03 41",
        '>' => "05 43 01",
        ' ' => "",
        _ => "00 06 46 40 00",
    }
}

/// Share of a capital's height that a small letter has.
const SMALL: f64 = 0.74;

/// Size of a letter against a capital: small letters are smaller.
fn scale_of(letter: char) -> f64 {
    if letter.is_ascii_lowercase() { SMALL } else { 1.0 }
}

/// Distance from one letter to the next, for a capital's height of 1.
fn advance(letter: char) -> f64 {
    let width = match letter {
        ' ' => 0.45,
        '.' | ',' | ':' => 0.55,
        _ => 0.98,
    };
    width * scale_of(letter)
}

/// Width of a line of text, for a capital's height of 1.
pub(crate) fn width(text: &str) -> f64 {
    text.chars().map(advance).sum()
}

/// Draws one line of text: for each pixel that a stroke covers, `paint(x, y, coverage 0 to 1)`.
///
/// `origin` is the left end of the baseline, `height` that of a capital, pixels; y points down.
pub(crate) fn draw(text: &str, origin: [f64; 2], height: f64, mut paint: impl FnMut(i64, i64, f32)) {
    let thickness = (height * 0.135).max(1.1);
    let mut pen = origin[0];
    for letter in text.chars() {
        let size = height * scale_of(letter);
        let shift = if matches!(letter, '.' | ',' | ':') { -0.24 } else { 0.0 };
        let segments = segments(letter, [pen + shift * size, origin[1]], size / 6.0);
        let reach = thickness;
        let (left, right) = ((pen - reach).floor() as i64, (pen + size + reach).ceil() as i64);
        let (top, bottom) = ((origin[1] - size - reach).floor() as i64, (origin[1] + reach).ceil() as i64);
        for y in top..=bottom {
            for x in left..=right {
                let d =
                    segments.iter().map(|s| distance(s, x as f64, y as f64)).fold(f64::INFINITY, f64::min);
                let coverage = (thickness / 2.0 + 0.5 - d).clamp(0.0, 1.0);
                if coverage > 0.0 {
                    paint(x, y, coverage as f32);
                }
            }
        }
        pen += advance(letter) * height;
    }
}

fn segments(letter: char, origin: [f64; 2], unit: f64) -> Vec<[f64; 4]> {
    let point = |code: &str| {
        let digits: Vec<f64> = code.chars().filter_map(|c| c.to_digit(10)).map(f64::from).collect();
        [origin[0] + digits[0] * unit, origin[1] - digits[1] * unit]
    };
    let mut out = Vec::new();
    for stroke in strokes(letter.to_ascii_uppercase()).split('|').filter(|s| !s.is_empty()) {
        let points: Vec<[f64; 2]> = stroke.split(' ').map(point).collect();
        out.extend(points.windows(2).map(|w| [w[0][0], w[0][1], w[1][0], w[1][1]]));
    }
    out
}

fn distance([ax, ay, bx, by]: &[f64; 4], x: f64, y: f64) -> f64 {
    let (dx, dy) = (bx - ax, by - ay);
    let length2 = dx * dx + dy * dy;
    let t = if length2 > 0.0 { (((x - ax) * dx + (y - ay) * dy) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (x - ax - t * dx).hypot(y - ay - t * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_letter_has_strokes_inside_its_cell() {
        for letter in (' '..='~').chain("ABCXYZ".chars()) {
            for [ax, ay, bx, by] in segments(letter, [0.0, 0.0], 1.0) {
                assert!([ax, bx].iter().all(|x| (0.0..=4.0).contains(x)), "{letter}");
                assert!([ay, by].iter().all(|y| (-6.0..=0.0).contains(y)), "{letter}");
            }
        }
    }

    #[test]
    fn text_paints_within_its_width() {
        let (mut count, mut right) = (0, 0);
        draw("LEAP 4F", [0.0, 20.0], 18.0, |x, _, c| {
            count += i32::from(c > 0.5);
            right = right.max(x);
        });
        assert!(count > 200);
        assert!((right as f64) < width("LEAP 4F") * 18.0 + 3.0);
    }
}
