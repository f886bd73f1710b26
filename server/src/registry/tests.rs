//! Tests of the registry: who may come and go, uploads that break rules, and folders.

use std::fs;
use std::path::PathBuf;

use bytes::Bytes;
use graspd_hands::library;
use graspd_proto::v1;
use graspd_proto::v1::create_hand_request::Part;

use super::*;

/// A folder that is removed at the end of its test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("graspd-registry-{name}-{}", std::process::id()));
        fs::remove_dir_all(&path).ok();
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn hand(&self, id: &str) -> PathBuf {
        let folder = self.0.join(id);
        fs::create_dir_all(folder.join("meshes")).unwrap();
        for (name, contents) in library::files("antipodal").unwrap().files {
            fs::write(folder.join(name), contents).unwrap();
        }
        folder
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn named(id: &str) -> Hand {
    Hand { id: id.to_owned(), ..library::hand("antipodal").unwrap().clone() }
}

#[test]
fn created_hands_come_and_go_and_library_hands_stay() {
    let registry = Registry::with_library();
    let library_count = registry.page(None, 1000).0.len();
    assert_eq!(library_count, library::ids().len());
    let entry = registry.create(named("mine")).unwrap();
    assert_eq!((entry.origin, entry.created.is_some()), (Origin::Created, true));
    assert_eq!(
        registry.create(named("mine")).unwrap_err(),
        ServiceError::HandExists { id: "mine".to_owned() }
    );
    registry.delete("mine").unwrap();
    let unknown = ServiceError::UnknownHand { name: "hands/mine".to_owned() };
    assert_eq!(registry.delete("mine").unwrap_err(), unknown);
    assert_eq!(registry.get("mine").unwrap_err(), unknown);
    let leap = ServiceError::HandProtected { id: "leap".to_owned() };
    assert_eq!(registry.delete("leap").unwrap_err(), leap);
    assert_eq!(registry.page(None, 1000).0.len(), library_count);
}

#[test]
fn pages_are_in_order_and_complete() {
    let registry = Registry::with_library();
    let all: Vec<_> = registry.page(None, 1000).0.iter().map(|e| e.hand.id.clone()).collect();
    assert!(all.is_sorted());
    let mut paged = Vec::new();
    loop {
        let (page, more) = registry.page(paged.last().map(String::as_str), 3);
        paged.extend(page.iter().map(|e| e.hand.id.clone()));
        if !more {
            break;
        }
        assert_eq!(page.len(), 3);
    }
    assert_eq!(paged, all);
}

#[test]
fn there_is_an_end_to_created_hands() {
    let registry = Registry::default();
    for i in 0..MOST_CREATED {
        registry.create(named(&format!("h{i}"))).unwrap();
    }
    assert!(matches!(
        registry.create(named("more")),
        Err(ServiceError::TooManyHands { limit: MOST_CREATED, .. })
    ));
}

fn header(hand_id: &str) -> Option<v1::CreateHandRequest> {
    let header =
        v1::CreateHandHeader { hand_id: hand_id.to_owned(), validate_only: false, ..Default::default() };
    Some(v1::CreateHandRequest { part: Some(Part::Header(header)) })
}

fn chunk(path: &str, data: &'static [u8]) -> v1::CreateHandRequest {
    let chunk = v1::FileChunk { path: path.to_owned(), data: Bytes::from_static(data) };
    v1::CreateHandRequest { part: Some(Part::Chunk(chunk)) }
}

#[test]
fn an_upload_puts_pieces_together() {
    let mut upload = Upload::begin(header("claw")).unwrap();
    for (path, data) in [("hand.urdf", b"ab".as_slice()), ("meshes/a.stl", b"x"), ("hand.urdf", b"cd")] {
        upload.push(chunk(path, data)).unwrap();
    }
    assert_eq!(upload.files.files["hand.urdf"], b"abcd");
    assert_eq!(upload.files.files["meshes/a.stl"], b"x");
}

#[test]
fn an_upload_that_breaks_a_rule_is_refused() {
    for id in ["", "Claw", "9claw", "-", "claw/..", &"c".repeat(64)] {
        assert!(
            matches!(Upload::begin(header(id)), Err(ServiceError::Field(f)) if f.field == "header.hand_id"),
            "{id}"
        );
    }
    assert!(
        matches!(Upload::begin(Some(chunk("hand.urdf", b""))), Err(ServiceError::Field(f)) if f.field == "header")
    );
    assert!(Upload::begin(None).is_err());
    for path in [
        "",
        "/etc/passwd",
        "../x",
        "meshes/../../x",
        "a//b",
        "./a",
        "a/",
        "C:/x",
        "a\\b",
        "a\0b",
        &"p".repeat(201),
    ] {
        let error = Upload::begin(header("claw")).unwrap().push(chunk(path, b"x")).unwrap_err();
        assert!(
            matches!(&error, ServiceError::BadUpload { field, .. } if field == "chunk.path"),
            "{path:?}: {error}"
        );
    }
    let mut many = Upload::begin(header("claw")).unwrap();
    for i in 0..64 {
        many.push(chunk(&format!("m{i}"), b"x")).unwrap();
    }
    many.push(chunk("m0", b"more of the same")).unwrap();
    assert!(many.push(chunk("m64", b"x")).is_err());
    static MEGABYTE: [u8; 1 << 20] = [0; 1 << 20];
    let mut large = Upload::begin(header("claw")).unwrap();
    for _ in 0..32 {
        large.push(chunk("mesh.stl", &MEGABYTE)).unwrap();
    }
    assert!(
        matches!(large.push(chunk("mesh.stl", b"x")), Err(ServiceError::BadUpload { field, .. }) if field == "chunk.data")
    );
    let mut twice = Upload::begin(header("claw")).unwrap();
    assert!(twice.push(header("claw").unwrap()).is_err());
    assert!(twice.push(v1::CreateHandRequest { part: None }).is_err());
}

#[test]
fn a_folder_of_hands_is_offered_beside_the_library() {
    let scratch = Scratch::new("offered");
    scratch.hand("mine");
    fs::write(scratch.0.join("README.md"), "not a hand").unwrap();
    let registry = Registry::with_library();
    assert_eq!(registry.add_folder(&scratch.0).unwrap(), 1);
    let entry = registry.get("mine").unwrap();
    assert_eq!(entry.origin, Origin::Folder);
    assert_eq!(registry.delete("mine").unwrap_err(), ServiceError::HandProtected { id: "mine".to_owned() });
    assert!(matches!(registry.add_folder(&scratch.0), Err(FolderError::Taken { .. })));
}

#[test]
fn a_folder_that_is_not_a_hand_is_refused_with_its_place() {
    let scratch = Scratch::new("refused");
    fs::create_dir_all(scratch.0.join("Bad Name")).unwrap();
    assert!(matches!(Registry::default().add_folder(&scratch.0), Err(FolderError::Name { .. })));
    fs::remove_dir(scratch.0.join("Bad Name")).unwrap();
    let folder = scratch.hand("mine");
    fs::write(folder.join("hand.urdf"), "<robot/>").unwrap();
    let error = Registry::default().add_folder(&scratch.0).unwrap_err();
    assert!(matches!(&error, FolderError::Hand { path, .. } if path.ends_with("mine")), "{error}");
    assert!(matches!(read_hand_dir(&scratch.0.join("nowhere")), Err(FolderError::Io { .. })));
    let many = scratch.hand("many");
    for i in 0..65 {
        fs::write(many.join(format!("f{i}")), "").unwrap();
    }
    assert!(matches!(read_hand_dir(&many), Err(FolderError::TooMuch { .. })));
    let large = scratch.hand("large");
    fs::File::create(large.join("mesh.stl")).unwrap().set_len(40 << 20).unwrap();
    assert!(matches!(read_hand_dir(&large), Err(FolderError::TooMuch { .. })));
}

#[cfg(unix)]
#[test]
fn links_are_refused_and_hidden_files_skipped() {
    let scratch = Scratch::new("links");
    let folder = scratch.hand("mine");
    fs::write(folder.join(".DS_Store"), "x").unwrap();
    assert_eq!(read_hand_dir(&folder).unwrap().files.len(), 2);
    std::os::unix::fs::symlink("/etc/passwd", folder.join("meshes/tip.stl")).unwrap();
    let error = read_hand_dir(&folder).unwrap_err();
    assert!(matches!(error, FolderError::NotPlain { found: "a symbolic link", .. }), "{error}");
}

#[test]
fn a_chain_of_errors_says_everything_once() {
    let scratch = Scratch::new("chain");
    fs::remove_file(scratch.hand("mine").join("hand.urdf")).unwrap();
    let hand = Registry::default().add_folder(&scratch.0).unwrap_err();
    let nowhere = Registry::default().add_folder(&scratch.0.join("nowhere")).unwrap_err();
    for error in [crate::ServeError::from(hand), crate::ServeError::from(nowhere)] {
        let mut links = Vec::new();
        let mut link: Option<&dyn std::error::Error> = Some(&error);
        while let Some(error) = link {
            links.push(error.to_string());
            link = error.source();
        }
        assert_eq!(links.len(), 3, "{links:?}");
        let chain = links.join(": ");
        for text in &links {
            assert_eq!(chain.matches(text.as_str()).count(), 1, "{text:?} in {chain:?}");
        }
    }
}
