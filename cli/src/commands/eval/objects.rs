//! The objects of an evaluation: procedural families, or a folder of meshes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use graspd_hands::library;
use graspd_sim::mesh::Mesh;
use graspd_sim::object::{MeshOptions, Object};
use graspd_training::evaluate::{draw, fits};

/// The hands of Supplementary Table 4: the narrowest of them decides how wide procedural objects may be.
const TABLE_HANDS: [&str; 7] =
    ["finray-2f", "robotiq-2f85", "robotiq-3f", "model-o", "finray-4f", "brunel", "leap"];

/// Which objects are grasped.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Objects")]
pub(crate) struct ObjectArgs {
    /// Procedural objects must fit a hand that opens this far, millimetres; the narrowest of the paper's seven
    /// if left out
    #[arg(long, value_name = "MM", value_parser = clap::value_parser!(u32).range(30..=500))]
    opening: Option<u32>,
    /// Grasp the meshes (OBJ, STL; closed, z up) of this folder instead, in the order of their names, again
    /// from the first where more objects are asked for than there are
    #[arg(long, value_name = "DIR", conflicts_with = "opening")]
    meshes: Option<PathBuf>,
    /// Metres in a unit of the meshes: 0.001 for millimetres
    #[arg(long, default_value_t = 1.0, value_name = "FACTOR", requires = "meshes")]
    mesh_scale: f64,
}

impl ObjectArgs {
    /// `count` objects, and what to say about them.
    ///
    /// # Errors
    /// For an opening that nothing fits, and meshes that cannot be read or are no closed solids.
    pub(crate) fn objects(&self, count: usize, seed: u64) -> anyhow::Result<(Vec<Arc<Object>>, String)> {
        if let Some(folder) = &self.meshes {
            return self.of_folder(folder, count);
        }
        let opening_m = self.opening.map_or_else(narrowest_m, |mm| f64::from(mm) / 1e3);
        let objects = draw(count, opening_m, seed);
        anyhow::ensure!(
            objects.len() == count,
            "--opening: found {:.0} mm, expected more: only {} of {count} objects fit",
            opening_m * 1e3,
            objects.len()
        );
        let about = format!(
            "{count} procedural objects, the same for every hand, none wider than 10 mm less than {:.0} mm and none \
             thinner than 20 mm",
            opening_m * 1e3
        );
        Ok((objects, about))
    }

    fn of_folder(&self, folder: &Path, count: usize) -> anyhow::Result<(Vec<Arc<Object>>, String)> {
        // No more than are grasped: cutting a mesh into convex parts takes a while.
        let objects = meshes(folder, self.mesh_scale, count)?;
        let opening_m = narrowest_m();
        let wide = objects.iter().filter(|o| !fits(o, opening_m)).count();
        let about = format!(
            "{count} objects, the same for every hand, of {} meshes; {wide} of these are wider than 10 mm less than \
             {:.0} mm or thinner than 20 mm",
            objects.len(),
            opening_m * 1e3
        );
        Ok((objects.iter().cycle().take(count).cloned().collect(), about))
    }
}

/// The objects of a folder's meshes (OBJ, STL), in the order of their names, `most` at most.
///
/// # Errors
/// For a folder without meshes, and meshes that cannot be read or are no closed solids.
pub(crate) fn meshes(folder: &Path, scale: f64, most: usize) -> anyhow::Result<Vec<Arc<Object>>> {
    let at = || folder.display().to_string();
    let entries = std::fs::read_dir(folder).with_context(at)?;
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| Ok(entry?.path())).collect::<Result<_, std::io::Error>>()?;
    paths.retain(|p| matches!(extension(p).as_str(), "obj" | "stl"));
    paths.sort();
    anyhow::ensure!(
        !paths.is_empty(),
        "{}: found no mesh, expected files ending in .obj or .stl",
        folder.display()
    );
    let options = MeshOptions { scale, ..MeshOptions::default() };
    paths.iter().take(most).map(|path| read(path, &options)).collect()
}

fn extension(path: &Path) -> String {
    path.extension().map_or_else(String::new, |e| e.to_string_lossy().to_lowercase())
}

fn read(path: &Path, options: &MeshOptions) -> anyhow::Result<Arc<Object>> {
    let at = || path.display().to_string();
    let bytes = std::fs::read(path).with_context(at)?;
    let parse = if extension(path) == "stl" { Mesh::from_stl } else { Mesh::from_obj };
    let mesh = parse(&bytes).with_context(at)?;
    let name = path.file_stem().map_or_else(at, |stem| stem.to_string_lossy().into_owned());
    Ok(Arc::new(Object::from_mesh(name, mesh, options).with_context(at)?))
}

/// How far the narrowest hand of the table opens, metres.
fn narrowest_m() -> f64 {
    let openings = TABLE_HANDS.iter().filter_map(|id| library::hand(id)?.opening).map(|o| o.max_m);
    openings.fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube of 40 units, as OBJ.
    fn cube() -> String {
        let mesh = Mesh::cuboid(nalgebra::Vector3::new(20.0, 20.0, 20.0));
        let vertices = mesh.vertices.iter().map(|v| format!("v {} {} {}\n", v.x, v.y, v.z));
        let faces = mesh.triangles.iter().map(|t| format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
        vertices.chain(faces).collect()
    }

    #[test]
    fn a_folder_of_meshes_gives_objects_by_name_again_and_again() {
        let folder = std::env::temp_dir().join(format!("graspd-meshes-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let args = ObjectArgs { opening: None, meshes: Some(folder.clone()), mesh_scale: 0.001 };
        assert!(args.objects(1, 0).unwrap_err().to_string().contains("found no mesh"));
        for name in ["b.obj", "a.OBJ", "readme.txt"] {
            std::fs::write(folder.join(name), cube()).unwrap();
        }
        let (objects, about) = args.objects(3, 0).unwrap();
        let names: Vec<&str> = objects.iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "a"]);
        assert!(about.contains("2 meshes; 0 of these"), "{about}");
        let (low, high) = objects[0].mesh.bounds().unwrap();
        assert!(((high - low).x - 0.04).abs() < 1e-6);
        std::fs::write(folder.join("c.stl"), "nothing").unwrap();
        let message = format!("{:#}", args.objects(3, 0).unwrap_err());
        assert!(message.contains("c.stl"), "{message}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn procedural_objects_fit_the_narrowest_hand() {
        let args = ObjectArgs { opening: None, meshes: None, mesh_scale: 1.0 };
        let (objects, _) = args.objects(10, 3).unwrap();
        assert!(objects.iter().all(|o| fits(o, narrowest_m())));
        assert!((0.05..0.15).contains(&narrowest_m()));
    }
}
