//! What is where in a shared world: by physics, never by what a device or a cell believes.

use graspd_sim::camera::Pinhole;
use graspd_sim::render::{self, RgbImage, View};
use graspd_sim::scene;
use graspd_sim::world::{HandId, ObjectId, Tray, World};
use nalgebra::{Isometry3, Point3};

use crate::bins::{Delivered, is_over, touched_objects};
use crate::shared::{SharedWorld, WorldEnded};

/// How far its lowest point must be above the table for an object that a hand touches to count as held, metres.
const LIFTED_M: f64 = 0.02;

/// An object of the world.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectView {
    /// Its id.
    pub id: ObjectId,
    /// Its name.
    pub name: String,
    /// Its pose.
    pub world_from_object: Isometry3<f64>,
}

/// Where every object is: each that ever was in the world is in one of the lists, unless somebody took it out by
/// [`SharedWorld::with`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Census {
    /// In the tray (where the default one would stand, in a world without), or above it and in no hand.
    pub tray: Vec<ObjectView>,
    /// In a hand: touched by it, with nothing of it within 2 cm of the table.
    pub held: Vec<(HandId, ObjectView)>,
    /// In a bin.
    pub delivered: Vec<Delivered>,
    /// Anywhere else: beside the tray, or off the table. Lost, where a cell should have delivered it.
    pub elsewhere: Vec<ObjectView>,
}

impl Census {
    /// Number of objects in all lists.
    pub fn total(&self) -> usize {
        self.tray.len() + self.held.len() + self.delivered.len() + self.elsewhere.len()
    }
}

impl SharedWorld {
    /// Every object of the world. What went into a bin is no longer among them.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn objects(&self) -> Result<Vec<ObjectView>, WorldEnded> {
        self.with(|world| objects(world)).await
    }

    /// Objects in hands.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn held(&self) -> Result<Vec<(HandId, ObjectView)>, WorldEnded> {
        Ok(self.census().await?.held)
    }

    /// Objects that went into bins, in order.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn delivered(&self) -> Result<Vec<Delivered>, WorldEnded> {
        self.on_stage(|stage| stage.delivered.clone()).await
    }

    /// Where every object is.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn census(&self) -> Result<Census, WorldEnded> {
        self.on_stage(|stage| census(&stage.world, &stage.delivered)).await
    }

    /// The world's scene file.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn scene_json(&self) -> Result<String, WorldEnded> {
        self.with(|world| scene::to_json(world)).await
    }

    /// What a perfect camera sees from a pose.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn view(&self, lens: Pinhole, world_from_camera: Isometry3<f64>) -> Result<View, WorldEnded> {
        self.with(move |world| render::capture(world, &lens, &world_from_camera)).await
    }

    /// A picture of the world for people, from a pose.
    ///
    /// # Errors
    /// [`WorldEnded`].
    pub async fn picture(
        &self,
        lens: Pinhole,
        world_from_camera: Isometry3<f64>,
    ) -> Result<RgbImage, WorldEnded> {
        self.with(move |world| render::picture(world, &lens, &world_from_camera)).await
    }
}

fn objects(world: &World) -> Vec<ObjectView> {
    world
        .ids()
        .into_iter()
        .filter_map(|id| {
            Some(ObjectView { id, name: world.object(id)?.name.clone(), world_from_object: world.pose(id)? })
        })
        .collect()
}

fn census(world: &World, delivered: &[Delivered]) -> Census {
    let touched = touched_objects(world);
    let mut census = Census { delivered: delivered.to_vec(), ..Census::default() };
    for object in objects(world) {
        let hand = touched.iter().find(|(_, id)| *id == object.id).map(|(hand, _)| *hand);
        let lifted = lowest_m(world, &object).is_some_and(|z| z > LIFTED_M);
        if let Some(hand) = hand.filter(|_| lifted) {
            census.held.push((hand, object));
        } else if in_tray(world.settings().tray.as_ref(), &object) {
            census.tray.push(object);
        } else {
            census.elsewhere.push(object);
        }
    }
    census
}

/// True when the object's origin is between the tray's walls, on them, or above. In a world without a tray its place is
/// where the default one would stand.
fn in_tray(tray: Option<&Tray>, object: &ObjectView) -> bool {
    let p = object.world_from_object.translation.vector;
    is_over(&tray.copied().unwrap_or_default(), &p) && p.z > -0.02
}

/// Height of an object's lowest point above the table, metres.
fn lowest_m(world: &World, view: &ObjectView) -> Option<f64> {
    let object = world.object(view.id)?;
    let height = |p: &Point3<f64>| (view.world_from_object * p).z;
    object.parts.iter().flatten().map(height).min_by(f64::total_cmp)
}
