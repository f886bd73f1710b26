//! Hostile input: whatever the bytes, loading ends with a hand or an error, never with a panic.

use graspd_hands::{Hand, HandError, HandFiles, check, library, propose};
use proptest::prelude::*;

const URDF: &str = "hand.urdf";
const TOML: &str = "hand.toml";

/// The panda hand: small, with a mimic tag.
fn panda() -> HandFiles {
    library::files("panda").unwrap_or_default()
}

fn text(files: &HandFiles, file: &str) -> String {
    String::from_utf8_lossy(&files.files[file]).into_owned()
}

/// The panda hand with one replacement in one file; the text to be replaced must be there.
fn with(file: &str, from: &str, to: &str) -> HandFiles {
    let mut files = panda();
    let before = text(&files, file);
    assert!(before.contains(from), "{file} contains {from}");
    files.files.insert(file.to_owned(), before.replacen(from, to, 1).into_bytes());
    files
}

/// The problems with which a hand is refused, as text.
fn refused(files: &HandFiles) -> String {
    match Hand::load("x", files) {
        Ok(_) => panic!("the hand was accepted"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn refuses_broken_trees() {
    let child = r#"<child link="panda_rightfinger"/>"#;
    let cases = [
        (child, r#"<child link="panda_leftfinger"/>"#, "two parents"),
        (child, r#"<child link="nobody"/>"#, "unknown link"),
        (r#"<parent link="panda_hand"/>"#, r#"<parent link="panda_leftfinger"/>"#, "root"),
        (r#"<link name="panda_leftfinger">"#, r#"<link name="panda_rightfinger">"#, "twice"),
        (r#"type="prismatic""#, r#"type="floating""#, "Floating"),
        (r#"type="prismatic""#, r#"type="planar""#, "Planar"),
        (r#"xyz="0 1 0""#, r#"xyz="0 0 0""#, "axis"),
        (r#"xyz="0 1 0""#, r#"xyz="0 NaN 0""#, "axis"),
        (r#"lower="0" upper="0.04""#, r#"lower="0.04" upper="0""#, "lower < upper"),
        (r#"lower="0" upper="0.04""#, r#"lower="0" upper="inf""#, "lower < upper"),
        (r#"xyz="0 0 0.0584""#, r#"xyz="0 0 58.4""#, "within ±2"),
        (r#"xyz="0 0 0.0584""#, r#"xyz="0 0 NaN""#, "finite"),
        (r#"<box size=""#, r#"<box size="-"#, "size"),
        (r#"<mimic joint="panda_finger_joint1""#, r#"<mimic joint="panda_finger_joint2""#, "never ends"),
        (r#"<mimic joint="panda_finger_joint1""#, r#"<mimic joint="nobody""#, "movable joint"),
        (r#"<?xml version="1.0"?>"#, "<!DOCTYPE r [<!ENTITY a \"b\">]>", "document type"),
    ];
    for (from, to, expected) in cases {
        let message = refused(&with(URDF, from, to));
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn names_limits_that_are_missing() {
    let limit = r#"<limit lower="0" upper="0.04" effort="70" velocity="0.05"/>"#;
    for (to, expected) in [
        ("", "limit: found no <limit>; expected"),
        (r#"<limit lower="0" effort="70" velocity="0.05"/>"#, "found a <limit> without upper;"),
        (r#"<limit effort="70" velocity="0.05"/>"#, "found a <limit> without lower and upper;"),
    ] {
        let message = refused(&with(URDF, limit, to));
        assert!(message.contains(expected), "{to}: {message}");
    }
    let report = check("x", &with(URDF, limit, r#"<limit upper="0.04" effort="70" velocity="0.05"/>"#));
    assert!(report.passed() && report.to_string().contains("found a <limit> without lower;"), "{report}");
}

#[test]
fn texts_of_other_encodings_are_named() {
    let urdf = text(&panda(), URDF);
    let mut utf16: Vec<u8> = urdf.encode_utf16().flat_map(u16::to_le_bytes).collect();
    let mut latin = urdf.clone().into_bytes();
    latin.splice(0..0, *b"<!-- \xe9 -->");
    for bytes in [utf16.clone(), latin] {
        let mut files = panda();
        files.files.insert(URDF.into(), bytes);
        let message = refused(&files);
        assert!(message.contains("not UTF-8") && !message.contains("links"), "{message}");
    }
    // Read as UTF-8 with replacements by somebody before.
    utf16.splice(0..0, [0xff, 0xfe]);
    let mut files = panda();
    files.files.insert(URDF.into(), String::from_utf8_lossy(&utf16).into_owned().into_bytes());
    assert!(refused(&files).contains("not UTF-8"));
}

#[test]
fn refuses_meshes_outside_the_folder_or_of_unknown_kinds() {
    for (mesh, expected) in [
        ("../secret.stl", "stays in the hand's folder"),
        ("/etc/passwd", "relative"),
        ("file:///etc/passwd.stl", "relative"),
        ("package://x/../../a.stl", "stays in the hand's folder"),
        ("meshes\\a.stl", "path"),
        ("meshes/a.dae", "convert the mesh to STL or OBJ"),
        ("meshes/a.stl", "no such file"),
    ] {
        let files = with(URDF, "<geometry><box", &format!("<geometry><mesh filename=\"{mesh}\"/><box"));
        // A geometry with two shapes is refused by the parser already; replace the box altogether.
        let urdf = text(&files, URDF);
        let (head, tail) = urdf.split_once("<box").unwrap_or_default();
        let (_, tail) = tail.split_once("/>").unwrap_or_default();
        let mut files = files.clone();
        files.files.insert(URDF.into(), format!("{head}{tail}").into_bytes());
        let message = refused(&files);
        assert!(message.contains(expected), "{mesh}: {message}");
    }
}

#[test]
fn loads_meshes_by_relative_and_package_names() {
    let stl = "solid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.05 0 0\nvertex 0 0.05 0\nendloop\nendfacet\n\
        facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 0.05 0\nvertex 0 0 0.05\nendloop\nendfacet\n\
        facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 0 0.05\nvertex 0.05 0 0\nendloop\nendfacet\n\
        facet normal 0 0 1\nouter loop\nvertex 0.05 0 0\nvertex 0 0 0.05\nvertex 0 0.05 0\nendloop\nendfacet\nendsolid t\n";
    let obj = "v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\nf 1/1 4/2/1 3\nf -3 -2 -1\n";
    for (name, file, contents, scale) in [
        ("meshes/t.stl", "meshes/t.stl", stl, "1 1 1"),
        ("package://hand/meshes/t.STL", "meshes/t.STL", stl, "1 1 1"),
        ("./meshes/t.obj", "meshes/t.obj", obj, "0.001 0.001 0.001"),
    ] {
        let base = panda();
        let urdf = text(&base, URDF);
        let (head, tail) = urdf.split_once("<box").unwrap_or_default();
        let (_, tail) = tail.split_once("/>").unwrap_or_default();
        let mesh = format!("<mesh filename=\"{name}\" scale=\"{scale}\"/>");
        let mut files = base.clone();
        files.files.insert(URDF.into(), format!("{head}{mesh}{tail}").into_bytes());
        files.files.insert(file.into(), contents.as_bytes().to_vec());
        let hand = Hand::load("x", &files).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(!hand.spheres.is_empty());
        // Metres matter: the same mesh a thousand times too large is refused.
        let huge = mesh.replace(&format!("scale=\"{scale}\""), "scale=\"1000 1000 1000\"");
        files.files.insert(URDF.into(), format!("{head}{huge}{tail}").into_bytes());
        assert!(refused(&files).contains("scale"), "{name}");
    }
}

#[test]
fn refuses_descriptions_that_contradict_the_urdf() {
    for (from, to, expected) in [
        ("open = 0.04", "open = 0.05", "open"),
        ("joint = \"panda_finger_joint1\"", "joint = \"elbow\"", "movable joint"),
        ("approach = [0.0, 0.0, 1.0]", "approach = [0.0, 0.0, 0.0]", "approach"),
        ("approach = [0.0, 0.0, 1.0]", "approach = [nan, 0.0, 1.0]", "approach"),
        ("half_u = [0.008, 0.0, 0.0]", "half_u = [0.0, 0.0, 0.0]", "half edges"),
        ("normal = [0.0, -1.0, 0.0]", "normal = [1.0, 0.0, 0.0]", "across both edges"),
        ("start_offset_m", "start_ofset_m", "unknown field"),
        ("tool_point = [0.0", "tool_point = [inf", "tool_point"),
        ("name = \"right\"", "name = \"left\"", "twice"),
        ("slope = ", "slope = -", "confidence.slope"),
        ("intercept = ", "intercept = nan # ", "confidence.intercept"),
        ("intercept = ", "# ", "intercept"),
    ] {
        let message = refused(&with(TOML, from, to));
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn refuses_ids_and_missing_files() {
    for id in ["", "Leap", "9", "-a", "a/b", &"a".repeat(64)] {
        assert!(matches!(Hand::load(id, &panda()), Err(HandError::BadId { .. })), "{id}");
    }
    assert!(matches!(Hand::load("x", &HandFiles::default()), Err(HandError::MissingFile { .. })));
}

#[test]
fn survives_deep_nesting() {
    for piece in ["<a>", "<robot name=\"x\">", "<link name=\"x\"><visual>"] {
        let mut files = panda();
        files.files.insert(URDF.into(), piece.repeat(50_000).into_bytes());
        assert!(Hand::load("x", &files).is_err());
    }
    let mut files = panda();
    files.files.insert(TOML.into(), format!("a = {}", "[".repeat(100_000)).into_bytes());
    assert!(Hand::load("x", &files).is_err());
}

/// A chain of links, each with boxes and a joint.
fn chain(links: usize, boxes: usize, size: &str) -> HandFiles {
    let mut urdf = String::from("<robot name=\"x\">");
    let mut actuators = String::new();
    for l in 0..links {
        urdf += &format!("<link name=\"l{l}\">");
        urdf += &format!("<collision><geometry><box size=\"{size}\"/></geometry></collision>").repeat(boxes);
        urdf += "</link>";
        if l > 0 {
            urdf += &format!(
                "<joint name=\"j{l}\" type=\"revolute\"><parent link=\"l{}\"/><child link=\"l{l}\"/>\
                 <origin xyz=\"0.01 0 0\"/><axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>",
                l - 1
            );
            actuators += &format!(
                "[[actuators]]\nname = \"a{l}\"\njoints = [{{ joint = \"j{l}\" }}]\nopen = 0.0\nclosed = 1.0\n"
            );
        }
    }
    let toml = format!(
        "display_name = \"x\"\napproach = [0.0, 0.0, 1.0]\n[[fingers]]\nname = \"f\"\n\
         [[pads]]\nname = \"p\"\nfinger = \"f\"\nlink = \"l1\"\ncenter = [0.0, 0.0, 0.0]\n\
         half_u = [0.01, 0.0, 0.0]\nhalf_v = [0.0, 0.01, 0.0]\nnormal = [0.0, 0.0, 1.0]\n{actuators}"
    );
    HandFiles::new(urdf + "</robot>", toml)
}

#[test]
fn bounds_the_work_for_a_hand() {
    assert!(refused(&chain(60, 60, "0.02 0.02 0.02")).contains("collision"));
    assert!(refused(&chain(200, 1, "0.02 0.02 0.02")).contains("links"));
    // Thin plates two metres wide would need thousands of spheres.
    assert!(refused(&chain(8, 2, "2 2 0.001")).contains("spheres"));
    // Within the bounds a large hand loads.
    let hand = Hand::load("x", &chain(40, 8, "0.02 0.02 0.02")).unwrap_or_else(|e| panic!("{e}"));
    assert!(hand.self_pairs.len() <= 256);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn arbitrary_bytes_never_panic(urdf in prop::collection::vec(any::<u8>(), 0..400), toml in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = check("x", &HandFiles::new(urdf, toml));
    }

    #[test]
    fn arbitrary_markup_never_panics(urdf in "(<[/!?]?[a-z]{0,6}( [a-z]{1,4}=\"[^\"<]{0,5}\")?/?>|&[a-z#x0-9]{0,5};|<!--|-->|[a-z ]{0,4}){0,30}") {
        let mut files = panda();
        files.files.insert(URDF.into(), urdf.into_bytes());
        let _ = check("x", &files);
    }

    #[test]
    fn arbitrary_meshes_never_panic(head in "(solid|facet|vertex|endfacet|v|f|[0-9.e+-]{0,6}|nan|inf|[ \n/]){0,60}", tail in prop::collection::vec(any::<u8>(), 0..200), obj in any::<bool>()) {
        let name = if obj { "m.obj" } else { "m.stl" };
        let urdf = text(&panda(), URDF);
        let (before, after) = urdf.split_once("<box").unwrap_or_default();
        let (_, after) = after.split_once("/>").unwrap_or_default();
        let mut files = panda();
        files.files.insert(URDF.into(), format!("{before}<mesh filename=\"{name}\"/>{after}").into_bytes());
        let mut bytes = head.into_bytes();
        bytes.extend(tail);
        files.files.insert(name.into(), bytes);
        let _ = check("x", &files);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(160))]

    /// Valid files with a few bytes changed, inserted or removed.
    #[test]
    fn mutated_files_never_panic(
        in_urdf in any::<bool>(),
        edits in prop::collection::vec((any::<prop::sample::Index>(), prop_oneof![
            any::<u8>().prop_map(|b| vec![b]),
            Just(Vec::new()),
            Just(b"1e308".to_vec()), Just(b"-".to_vec()), Just(b"nan".to_vec()), Just(b"<link".to_vec()), Just(b"0".to_vec()), Just(b"9".to_vec()),
        ], 0..3_usize), 1..4),
    ) {
        let mut files = panda();
        let file = if in_urdf { URDF } else { TOML };
        let mut bytes = files.files[file].clone();
        for (at, insert, remove) in edits {
            let at = at.index(bytes.len());
            let end = (at + remove).min(bytes.len());
            bytes.splice(at..end, insert);
        }
        files.files.insert(file.into(), bytes);
        // A hand that is accepted must be sound: finite spheres, postures inside limits.
        if let Ok(hand) = Hand::load("x", &files) {
            prop_assert!(hand.spheres.iter().all(|s| s.radius.is_finite() && s.radius > 0.0 && s.center.iter().all(|c| c.is_finite())));
            for c in &hand.actuation.coordinates {
                prop_assert!(c.lower <= c.open && c.open <= c.upper && c.lower <= c.closed && c.closed <= c.upper);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Proposing a description for a damaged URDF ends with a proposal or an error.
    #[test]
    fn proposals_for_mutated_urdfs_never_panic(edits in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 1..5)) {
        let mut bytes = panda().files[URDF].clone();
        let digits: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i].is_ascii_digit()).collect();
        for (at, digit) in edits {
            bytes[digits[at.index(digits.len())]] = digit;
        }
        let urdf = String::from_utf8_lossy(&bytes).into_owned();
        if let Ok(toml) = propose(&urdf, &HandFiles::default()) {
            prop_assert!(Hand::load("x", &HandFiles::new(urdf, toml)).is_ok());
        }
    }
}
