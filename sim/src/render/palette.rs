//! Colours of pictures.

use nalgebra::Vector3;

type Light = Vector3<f32>;

/// The table: light warm grey.
pub(super) const TABLE: Light = Light::new(0.70, 0.68, 0.64);
/// The tray: slate.
pub(super) const TRAY: Light = Light::new(0.16, 0.20, 0.25);
/// Hands: neutral grey-blue.
pub(super) const HAND: Light = Light::new(0.27, 0.33, 0.41);

/// Objects one after the other, sRGB: neighbours in the list are far apart in hue.
const OBJECTS: [[u8; 3]; 12] = [
    [226, 87, 76],
    [66, 135, 200],
    [244, 180, 60],
    [82, 168, 107],
    [148, 103, 189],
    [240, 130, 60],
    [64, 176, 184],
    [222, 120, 165],
    [160, 178, 66],
    [92, 108, 192],
    [190, 120, 80],
    [240, 210, 120],
];

/// From far (0) to near (1), sRGB: dark violet over teal to yellow, evenly lighter.
const DEPTHS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];

/// Colour of an object by its number, which begins at 1. After a round of the list, the next is darker.
pub(super) fn object(number: u32) -> Light {
    let index = number.max(1) as usize - 1;
    let dim = [1.0, 0.6, 0.8][index / OBJECTS.len() % 3];
    decode(OBJECTS[index % OBJECTS.len()]) * dim
}

/// What is seen where there is nothing; `height` is the sine of the angle above the horizon.
pub(super) fn sky(height: f32) -> Light {
    let share = (0.5 + 0.5 * height).clamp(0.0, 1.0);
    Light::new(0.62, 0.66, 0.72).lerp(&Light::new(0.90, 0.93, 0.97), share)
}

/// False colour of a share, 0 to 1.
pub(super) fn false_colour(share: f32) -> [u8; 3] {
    let last = DEPTHS.len() - 1;
    let x = share.clamp(0.0, 1.0) * last as f32;
    // A share that is not a number is drawn as far.
    let i = (x as usize).min(last - 1);
    let t = if x.is_nan() { 0.0 } else { x - i as f32 };
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(DEPTHS[i][c]), f32::from(DEPTHS[i + 1][c]));
        (a + (b - a) * t).round() as u8
    })
}

/// sRGB from linear light.
pub(super) fn encode(light: &Light) -> [u8; 3] {
    let channel = |x: f32| {
        let x = x.clamp(0.0, 1.0);
        let curved = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        (curved * 255.0).round() as u8
    };
    [channel(light.x), channel(light.y), channel(light.z)]
}

/// Linear light from sRGB.
fn decode(pixel: [u8; 3]) -> Light {
    let channel = |x: u8| {
        let x = f32::from(x) / 255.0;
        if x <= 0.040_45 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
    };
    Light::from(pixel.map(channel))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_survive_the_way_there_and_back() {
        for pixel in OBJECTS {
            assert_eq!(encode(&decode(pixel)), pixel);
        }
    }

    #[test]
    fn false_colours_begin_and_end_with_the_list_and_take_anything() {
        assert_eq!(false_colour(0.0), DEPTHS[0]);
        assert_eq!(false_colour(f32::INFINITY), DEPTHS[8]);
        assert_eq!(false_colour(f32::NAN), DEPTHS[0]);
        let brightness = |s: f32| false_colour(s).map(u32::from).iter().sum::<u32>();
        assert!((0..20).all(|i| brightness(i as f32 / 20.0) <= brightness((i + 1) as f32 / 20.0) + 8));
    }
}
