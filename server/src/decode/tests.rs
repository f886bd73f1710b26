//! Tests of image decoding: the rules for sizes and special values, and hostile bytes.

use proptest::prelude::*;

use super::*;

const MM: f64 = 0.001;

fn png_file(
    width: u32,
    height: u32,
    color: ::png::ColorType,
    depth: ::png::BitDepth,
    data: &[u8],
) -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut file, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(data).unwrap();
    drop(writer);
    file
}

fn depth_png(width: u32, height: u32, pixels: &[u16]) -> Vec<u8> {
    let bytes: Vec<u8> = pixels.iter().flat_map(|p| p.to_be_bytes()).collect();
    png_file(width, height, ::png::ColorType::Grayscale, ::png::BitDepth::Sixteen, &bytes)
}

#[test]
fn raw_and_png_pixels_give_the_same_metres() {
    let pixels = [0u16, 1, 500, 65535, 1234, 2];
    let raw: Vec<u8> = pixels.iter().flat_map(|p| p.to_le_bytes()).collect();
    let from_raw = depth(DepthEncoding::RawU16 { scale_m: MM }, Some((3, 2)), &raw).unwrap();
    let file = depth_png(3, 2, &pixels);
    let from_png = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &file).unwrap();
    assert!(from_raw.image.depth_m[0].is_nan());
    assert!((from_raw.image.depth_m[2] - 0.5).abs() < 1e-6);
    assert_eq!(from_raw.image.depth_m[1..], from_png.image.depth_m[1..]);
    assert_eq!((from_png.image.width, from_png.image.height), (3, 2));
}

#[test]
fn impossible_distances_are_counted_and_nan_is_not() {
    let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.2, 0.0, 0.75];
    let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let decoded = depth(DepthEncoding::RawF32, Some((6, 1)), &raw).unwrap();
    assert_eq!(decoded.invalid_pixels, 3);
    assert_eq!(decoded.image.depth_m.iter().filter(|d| d.is_nan()).count(), 5);
    assert_eq!(decoded.image.depth_m[5], 0.75);
}

#[test]
fn faults_name_the_part_and_what_was_expected() {
    let scale = DepthEncoding::RawU16 { scale_m: MM };
    let short = depth(scale, Some((4, 4)), &[0; 31]).unwrap_err();
    assert_eq!(short.part, Part::Data);
    assert_eq!(short.to_string(), "found 31 bytes, expected 32 bytes (4 × 4 pixels of 2 bytes)");
    assert_eq!(depth(scale, Some((0, 4)), &[]).unwrap_err().part, Part::Width);
    assert_eq!(depth(scale, None, &[]).unwrap_err().part, Part::Width);
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300] {
        let error = depth(DepthEncoding::RawU16 { scale_m: bad }, Some((1, 1)), &[0; 2]).unwrap_err();
        assert_eq!(error.part, Part::Scale, "{bad}");
    }
    let large = depth(DepthEncoding::RawF32, Some((usize::MAX, 2)), &[]).unwrap_err();
    assert!(large.expected.contains("at most"), "{large}");
}

#[test]
fn a_png_of_another_kind_or_size_is_refused() {
    let eight = png_file(2, 2, ::png::ColorType::Grayscale, ::png::BitDepth::Eight, &[0; 4]);
    let error = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &eight).unwrap_err();
    assert_eq!(
        error.to_string(),
        "found a PNG file of 8-bit Grayscale, expected a PNG file of 16-bit grayscale"
    );
    assert_eq!(labels(LabelEncoding::PngU8, 2, 2, &eight).unwrap(), vec![0; 4]);
    assert_eq!(labels(LabelEncoding::PngU8, 2, 3, &eight).unwrap_err().part, Part::Height);
    assert_eq!(labels(LabelEncoding::RawU8, 2, 2, &[1; 3]).unwrap_err().part, Part::Data);
}

#[test]
fn every_truncation_of_a_png_is_an_error() {
    let pixels: Vec<u16> = (0..64 * 48).map(|i| (i * 37 % 4001) as u16).collect();
    let file = depth_png(64, 48, &pixels);
    // The last chunk (12 bytes of IEND) carries no pixels.
    for end in (0..file.len() - 24).step_by(97) {
        let error = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &file[..end]).unwrap_err();
        assert_eq!(error.part, Part::Data, "{end}");
    }
}

#[test]
fn a_small_file_cannot_announce_a_large_image() {
    let mut file = depth_png(8, 8, &[7; 64]);
    // Width and height sit behind the signature and the chunk's length and type; its checksum follows.
    let edit = |file: &mut Vec<u8>, width: u32, height: u32| {
        file[16..20].copy_from_slice(&width.to_be_bytes());
        file[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc32(&file[12..29]);
        file[29..33].copy_from_slice(&crc.to_be_bytes());
    };
    edit(&mut file, 2000, 2000);
    let bomb = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &file).unwrap_err();
    assert!(bomb.expected.contains("so few bytes"), "{bomb}");
    edit(&mut file, 1 << 30, 1 << 30);
    let huge = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &file).unwrap_err();
    assert_eq!(huge.part, Part::Data, "{huge}");
}

/// The checksum of PNG chunks (ISO 3309), bit by bit.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    })
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(
        data in proptest::collection::vec(any::<u8>(), 0..400),
        width in 0usize..40,
        height in 0usize..40,
        scale in any::<f64>(),
    ) {
        for encoding in [
            DepthEncoding::RawU16 { scale_m: scale },
            DepthEncoding::RawF32,
            DepthEncoding::PngU16 { scale_m: scale },
        ] {
            for size in [None, Some((width, height))] {
                if let Ok(decoded) = depth(encoding, size, &data) {
                    let image = decoded.image;
                    prop_assert_eq!(image.depth_m.len(), image.width * image.height);
                    prop_assert!(image.depth_m.iter().all(|d| d.is_nan() || (d.is_finite() && *d > 0.0)));
                }
            }
        }
        labels(LabelEncoding::RawU8, width, height, &data).ok();
        labels(LabelEncoding::PngU8, width, height, &data).ok();
    }

    #[test]
    fn a_damaged_png_never_panics(at in 0usize..2000, flip in 1u8..=255) {
        let pixels: Vec<u16> = (0..24 * 16).map(|i| (i * 91 % 3001) as u16).collect();
        let mut file = depth_png(24, 16, &pixels);
        let at = at % file.len();
        file[at] ^= flip;
        if let Ok(decoded) = depth(DepthEncoding::PngU16 { scale_m: MM }, None, &file) {
            prop_assert_eq!(decoded.image.depth_m.len(), decoded.image.width * decoded.image.height);
        }
    }
}
