//! The Python reader and the Rust reader see the same in the same shard, and refuse the same damage.
//!
//! Needs `python3` with numpy (another interpreter: `GRASPD_PYTHON`); says so and passes where there is none.

use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;

use graspd_training::dataset::families::{Split, Stock};
use graspd_training::dataset::generate::{GenerateSettings, Generator};
use graspd_training::dataset::read::Shard;
use graspd_training::dataset::recipe::Recipe;
use graspd_training::dataset::sample::Sample;
use serde_json::{Value, json};

/// What a reader says of a sample: numbers that depend on every field.
const DESCRIBE: &str = r#"
import json, sys
import numpy as np
from graspd_train.shards import Dataset, Shard, ShardError
out = []
for s in Dataset(sys.argv[1]):
    place = np.arange(1, s.tsdf.size + 1, dtype=np.int64) % 9973
    q = s.contact_quaternion.astype(np.float64)
    out.append({
        "scene": s.scene, "view": s.view, "resolution": s.resolution,
        "volume": s.world_from_volume.reshape(-1).astype(float).tolist(),
        "camera": s.world_from_camera.reshape(-1).astype(float).tolist(),
        "table": s.table_m,
        "tsdf": int((s.tsdf.reshape(-1) * place).sum()),
        "occupancy": int((s.occupancy.reshape(-1) * place).sum()),
        "contacts": [int(i) for i in s.contact_index], "scores": int(np.rint(s.contact_score * 255).sum()),
        "free": len(s.contacts("occupancy")[0]),
        "quaternions": q.sum(axis=0).tolist(),
        "centroids": [int(i) for i in s.centroid_index], "centroid_scores": int(np.rint(s.centroid_score * 255).sum()),
        "preview": [*s.preview_mm.shape, int(s.preview_mm.astype(np.int64).sum())],
    })
print(json.dumps(out))
"#;

/// Says why a shard is refused.
const REFUSE: &str = r#"
import sys
from graspd_train.shards import Shard, ShardError
try:
    print(len([s for s in Shard(sys.argv[1])]))
except ShardError as error:
    print(error)
"#;

fn describe(sample: &Sample) -> Value {
    let place = |i: usize| (i as u64 + 1) % 9973;
    let voxels = sample.tsdf.len();
    let quaternions = sample.contacts.iter().fold([0.0; 4], |sum, c| {
        let q = c.quaternion();
        std::array::from_fn(|i| sum[i] + q.coords[i])
    });
    json!({
        "scene": sample.scene, "view": sample.view, "resolution": sample.resolution,
        "volume": sample.world_from_volume, "camera": sample.world_from_camera, "table": sample.table_m,
        "tsdf": sample.tsdf.iter().enumerate().map(|(i, &v)| u64::from(v) * place(i)).sum::<u64>(),
        "occupancy": (0..voxels).filter(|&i| sample.is_occupied(i)).map(place).sum::<u64>(),
        "contacts": sample.contacts.iter().map(|c| c.index).collect::<Vec<_>>(),
        "scores": sample.contacts.iter().map(|c| u64::from(c.score)).sum::<u64>(),
        "free": sample.contacts_of_occupancy().count(),
        "quaternions": quaternions,
        "centroids": sample.centroids.iter().map(|c| c.index).collect::<Vec<_>>(),
        "centroid_scores": sample.centroids.iter().map(|c| u64::from(c.score)).sum::<u64>(),
        "preview": [u64::from(sample.preview.height), u64::from(sample.preview.width),
            sample.preview.depth_mm.iter().map(|&d| u64::from(d)).sum::<u64>()],
    })
}

/// The same value, numbers within what single precision leaves.
fn alike(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap_or(f64::NAN), b.as_f64().unwrap_or(f64::NAN));
            (a - b).abs() <= 2e-4 * a.abs().max(1.0)
        }
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| alike(a, b)),
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(k, v)| b.get(k).is_some_and(|w| alike(v, w)))
        }
        _ => a == b,
    }
}

fn python() -> Command {
    let name = std::env::var("GRASPD_PYTHON").unwrap_or_else(|_| "python3".into());
    let mut command = Command::new(name);
    command.env("PYTHONPATH", Path::new(env!("CARGO_MANIFEST_DIR")).join("train"));
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command
}

fn ask(script: &str, path: &Path) -> String {
    let output = python().args(["-c", script]).arg(path).output().expect("python runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text").trim().to_owned()
}

/// A folder of this test's own, removed at its end.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn both_readers_agree() {
    if !python().args(["-c", "import numpy"]).output().is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: no python3 with numpy here (GRASPD_PYTHON names another interpreter)");
        return;
    }
    let folder = Folder(std::env::temp_dir().join(format!("graspd-python-reader-{}", std::process::id())));
    std::fs::create_dir_all(&folder.0).unwrap();
    let mut expected = Vec::new();
    for part in 0..2 {
        let generator = Generator::new(GenerateSettings {
            stock: Stock::families(Split::HeldOut),
            families: Split::HeldOut,
            sensor: "pico-flexx".into(),
            recipe: Recipe { objects: [2, 2], places: [40, 80], ..Recipe::for_sensor("pico-flexx") },
            scenes: 2,
            views: 2,
            shard: [part, 2],
            seed: 9,
            program: "test".into(),
            commit: None,
        })
        .unwrap();
        let mut bytes = generator.header().to_bytes();
        let append = |record: &[u8]| {
            bytes.extend(record);
            Ok(())
        };
        generator.generate(0, 1, append, |_, _| {}).unwrap();
        let mut shard = Shard::open(Cursor::new(&bytes)).unwrap();
        expected.extend((0..shard.len()).map(|i| describe(&shard.read(i).unwrap())));
        std::fs::write(folder.0.join(generator.header().file_name()), &bytes).unwrap();

        // Cut off: what is whole remains. A bit wrong: refused with the same words.
        let damaged = folder.0.join("damaged");
        std::fs::write(&damaged, &bytes[..bytes.len() - 10]).unwrap();
        assert_eq!(ask(REFUSE, &damaged), "1");
        let mut garbled = bytes.clone();
        let last = garbled.len() - 1;
        garbled[last] ^= 1;
        std::fs::write(&damaged, &garbled).unwrap();
        let error = Shard::open(Cursor::new(&garbled)).unwrap().read(1).unwrap_err().to_string();
        assert!(ask(REFUSE, &damaged).ends_with(&error), "{error}");
        std::fs::write(&damaged, b"GIF89a and more bytes").unwrap();
        assert!(ask(REFUSE, &damaged).starts_with("magic: found "));
    }
    let found: Value = serde_json::from_str(&ask(DESCRIBE, &folder.0)).unwrap();
    let found = found.as_array().unwrap();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        assert!(alike(found, expected), "found {found}\nexpected {expected}");
    }
    assert!(expected.iter().all(|s| s["contacts"].as_array().is_some_and(|c| !c.is_empty())));
}
