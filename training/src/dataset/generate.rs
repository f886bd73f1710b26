//! Generation: scenes on all cores, records in order, from where an interrupted run stopped.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;

use graspd_planner::grid::Grid;
use graspd_planner::options::VolumeKind;
use graspd_planner::volume::TRUNCATION_VOXELS;
use graspd_sim::sensor::{DepthCamera, Sensor};

use super::DatasetError;
use super::clutter::{Clutter, clutter};
use super::contacts::{SceneContacts, contacts};
use super::families::{Split, Stock};
use super::recipe::Recipe;
use super::sample::{OCCUPIED, Sample, rows};
use super::shard::{FORMAT, GridHeader, Header, record};
use super::view::{Observation, observe, viewpoint};
use super::voxels::voxelize;
use crate::evaluate::seeds::derive;

/// Scenes that may be begun before the oldest is written, for each worker: bounds what waits in memory.
const AHEAD: usize = 4;

/// What is generated.
#[derive(Debug, Clone)]
pub struct GenerateSettings {
    /// What objects are drawn from: those of `families`.
    pub stock: Stock,
    /// For the header.
    pub families: Split,
    /// Name of the depth camera, one of [`Sensor::NAMES`].
    pub sensor: String,
    /// Every number.
    pub recipe: Recipe,
    /// Scenes of all shards together.
    pub scenes: u32,
    /// Views of each.
    pub views: u32,
    /// Which shard, of how many.
    pub shard: [u32; 2],
    /// Same seed, same data.
    pub seed: u64,
    /// Program and version, for the header.
    pub program: String,
    /// Commit of the source, for the header.
    pub commit: Option<String>,
}

/// A dataset's shard, ready to be made.
#[derive(Debug, Clone)]
pub struct Generator {
    header: Header,
    stock: Stock,
    sensor: Sensor,
    grid: Grid,
}

impl Generator {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`DatasetError::Setting`] for the first that is of no use.
    pub fn new(settings: GenerateSettings) -> Result<Self, DatasetError> {
        let wrong =
            |field, found: String, expected: String| Err(DatasetError::Setting { field, found, expected });
        settings.recipe.check()?;
        let Some(sensor) = Sensor::by_name(&settings.sensor) else {
            return wrong("sensor", settings.sensor, Sensor::NAMES.join(", "));
        };
        for (field, count) in [("scenes", settings.scenes), ("views", settings.views)] {
            if count == 0 {
                return wrong(field, "0".into(), "at least 1".into());
            }
        }
        let [i, n] = settings.shard;
        if i >= n {
            return wrong("shard", format!("{i}/{n}"), "i/n with i from 0 to n - 1".into());
        }
        if settings.stock.is_empty() {
            return wrong("objects", "none".into(), "at least one (every fourth mesh is held out)".into());
        }
        let grid = Grid::default();
        let header = Header {
            format: FORMAT.into(),
            program: settings.program,
            commit: settings.commit,
            seed: settings.seed,
            scenes: settings.scenes,
            views: settings.views,
            shard: settings.shard,
            grid: GridHeader::from(grid),
            truncation_voxels: TRUNCATION_VOXELS,
            sensor: settings.sensor,
            families: settings.families,
            objects: settings.stock.names(),
            recipe: settings.recipe,
        };
        Ok(Self { header, stock: settings.stock, sensor, grid })
    }

    /// The shard's header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// A scene at rest, and its contacts.
    ///
    /// # Errors
    /// [`DatasetError::Arrange`] when its objects find no rest.
    pub fn scene(&self, scene: u32) -> Result<(Clutter, SceneContacts), DatasetError> {
        let recipe = &self.header.recipe;
        let clutter = clutter(recipe, &self.stock, &self.sensor, self.header.seed, scene)?;
        let contacts = contacts(&clutter.world, recipe, clutter.seed);
        Ok((clutter, contacts))
    }

    /// One view of a scene, labelled.
    ///
    /// # Errors
    /// [`DatasetError::Frame`] for what the planner refuses.
    pub fn view(
        &self,
        scene: u32,
        (clutter, contacts): &(Clutter, SceneContacts),
        camera: &mut DepthCamera,
        view: u32,
    ) -> Result<Sample, DatasetError> {
        let viewpoint = viewpoint(&self.header.recipe, &self.grid, clutter.seed, view, self.header.views);
        let noise = derive(clutter.seed, &[8, u64::from(view)]);
        let observation = observe(camera, &clutter.world, &viewpoint, self.grid, noise)?;
        Ok(sample(scene, view, &observation, contacts))
    }

    /// Makes the shard's records from number `done` on, in order, with `workers` scenes at the same time. `write` takes
    /// each record's bytes; `seen` is told how many of how many records there are.
    ///
    /// # Errors
    /// [`DatasetError`] when a scene cannot be made or `write` fails.
    pub fn generate(
        &self,
        done: usize,
        workers: usize,
        mut write: impl FnMut(&[u8]) -> std::io::Result<()>,
        seen: impl Fn(usize, usize),
    ) -> Result<(), DatasetError> {
        let all = self.header.records();
        let views = self.header.views as usize;
        let scenes: Vec<u32> = self.header.scenes_here().collect();
        let (next, written) = (AtomicUsize::new(done / views), AtomicUsize::new(done / views));
        let stop = AtomicBool::new(false);
        let (out, records) = mpsc::channel::<Result<(usize, Vec<u8>), DatasetError>>();
        let work = |out: &mpsc::Sender<_>| -> Result<(), DatasetError> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
            loop {
                let at = next.fetch_add(1, Ordering::Relaxed);
                let Some(&scene) = scenes.get(at) else { return Ok(()) };
                while at >= written.load(Ordering::Relaxed) + AHEAD * workers.max(1) {
                    if stop.load(Ordering::Relaxed) {
                        return Ok(());
                    }
                    std::thread::sleep(std::time::Duration::from_millis(5));
                }
                pool.install(|| self.records_of(scene, at * views, done, &stop, out))?;
                if stop.load(Ordering::Relaxed) {
                    return Ok(());
                }
            }
        };
        std::thread::scope(|scope| {
            for _ in 0..workers.clamp(1, scenes.len().max(1)) {
                let (out, work) = (out.clone(), &work);
                scope.spawn(move || {
                    if let Err(error) = work(&out) {
                        out.send(Err(error)).ok();
                    }
                });
            }
            drop(out);
            let mut count = done;
            let mut waiting = BTreeMap::new();
            let mut keep = || -> Result<(), DatasetError> {
                seen(count, all);
                for message in &records {
                    let (number, bytes) = message?;
                    waiting.insert(number, bytes);
                    while let Some(bytes) = waiting.remove(&count) {
                        write(&bytes)?;
                        count += 1;
                        written.store(count / views, Ordering::Relaxed);
                        seen(count, all);
                    }
                }
                Ok(())
            };
            let result = keep();
            stop.store(true, Ordering::Relaxed);
            result
        })
    }

    /// Sends the records of a scene whose first has this number, but for those that are done.
    fn records_of(
        &self,
        scene: u32,
        first: usize,
        done: usize,
        stop: &AtomicBool,
        out: &mpsc::Sender<Result<(usize, Vec<u8>), DatasetError>>,
    ) -> Result<(), DatasetError> {
        let made = self.scene(scene)?;
        let mut camera = DepthCamera::new(made.0.sensor.clone());
        for view in 0..self.header.views {
            let number = first + view as usize;
            if number < done {
                continue;
            }
            if stop.load(Ordering::Relaxed) {
                return Ok(());
            }
            let bytes = record(&self.view(scene, &made, &mut camera, view)?);
            if out.send(Ok((number, bytes))).is_err() {
                return Ok(());
            }
        }
        Ok(())
    }
}

/// An observation as it is kept, with the labels that it shows.
fn sample(scene: u32, view: u32, observation: &Observation, contacts: &SceneContacts) -> Sample {
    let Observation { world_from_camera, workspace, volume, preview } = observation;
    let code = |v: f32| (v * 255.0).round() as u8;
    let tsdf: Vec<u8> = volume.network_input(VolumeKind::Tsdf).into_iter().map(code).collect();
    let occupied = volume.network_input(VolumeKind::Occupancy);
    let occupancy = occupied
        .chunks(8)
        .map(|bits| bits.iter().enumerate().map(|(i, &v)| u8::from(v > 0.5) << i).sum())
        .collect();
    let is_occupied = |i: usize| tsdf.get(i).is_some_and(|v| OCCUPIED.contains(v));
    let labels = voxelize(contacts, &workspace.grid, &workspace.world_from_volume, is_occupied);
    Sample {
        scene,
        view,
        resolution: workspace.grid.resolution as u32,
        world_from_volume: rows(&workspace.world_from_volume),
        world_from_camera: rows(world_from_camera),
        table_m: workspace.table_m.map_or(f32::NAN, |m| m as f32),
        tsdf,
        occupancy,
        contacts: labels.contacts,
        centroids: labels.centroids,
        preview: preview.clone(),
    }
}
