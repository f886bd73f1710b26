//! Writes pictures of a small world as portable pixmaps (PPM) into a folder: `cargo run --example look -- FOLDER`.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use graspd_hands::Shape;
use graspd_sim::camera::look_at;
use graspd_sim::mesh::Mesh;
use graspd_sim::object::{Object, Source, Surface};
use graspd_sim::render::{RgbImage, capture, depth_picture, picture, solids};
use graspd_sim::sensor::Sensor;
use graspd_sim::world::{Tray, World, WorldSettings};
use nalgebra::{Isometry3, Point3, Vector3};

fn main() -> std::io::Result<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| ".".into());
    let folder = Path::new(&folder);
    let world = world();
    let sensor = Sensor::azure_kinect();
    let eye = look_at(&Point3::new(0.35, -0.25, 0.6), &Point3::new(0.0, 0.0, 0.03), &Vector3::z());
    save(&folder.join("scene.ppm"), &picture(&world, &sensor.lens, &eye))?;
    for (name, sensor) in [("kinect", sensor), ("flexx", Sensor::pico_flexx())] {
        let view = capture(&world, &sensor.lens, &eye);
        let exact = Sensor::ideal(sensor.lens).observe(&view, 0);
        save(&folder.join(format!("{name}_exact.ppm")), &depth_picture(&exact, [0.5, 1.0]))?;
        save(&folder.join(format!("{name}.ppm")), &depth_picture(&sensor.observe(&view, 1), [0.5, 1.0]))?;
    }
    Ok(())
}

fn world() -> World {
    let mut world = World::new(WorldSettings { tray: Some(Tray::default()), ..Default::default() });
    let solid = |shape: Shape| solids::triangulate(&shape).into_mesh();
    let mut add = |mesh: Mesh, surface: Surface, at: [f64; 3], turn: [f64; 3]| {
        let parts = vec![mesh.vertices.clone()];
        let object = Object {
            name: "solid".into(),
            mesh: mesh.into(),
            parts,
            mass_kg: 0.2,
            friction: 0.5,
            surface,
            source: Source::Mesh,
        };
        world.add(Arc::new(object), &Isometry3::new(Vector3::from(at), Vector3::from(turn)));
    };
    let matt = Surface { albedo: 0.6, specular: 0.0 };
    let dark = Surface { albedo: 0.05, specular: 0.0 };
    let polished = Surface { albedo: 0.6, specular: 0.7 };
    add(Mesh::cuboid(Vector3::new(0.03, 0.045, 0.04)), matt, [0.05, 0.05, 0.04], [0.0, 0.0, 0.4]);
    add(solid(Shape::Sphere { radius: 0.035 }), matt, [-0.05, -0.06, 0.035], [0.0; 3]);
    add(solid(Shape::Cylinder { radius: 0.033, half_length: 0.05 }), polished, [-0.06, 0.06, 0.05], [0.0; 3]);
    add(Mesh::cuboid(Vector3::new(0.08, 0.012, 0.01)), matt, [0.06, -0.08, 0.01], [0.0, 0.0, -0.5]);
    add(
        solid(Shape::Cylinder { radius: 0.02, half_length: 0.06 }),
        dark,
        [0.11, 0.0, 0.02],
        [std::f64::consts::FRAC_PI_2, 0.0, 0.0],
    );
    add(Mesh::cuboid(Vector3::repeat(0.02)), matt, [-0.12, -0.12, 0.02], [0.0, 0.0, 0.2]);
    world
}

fn save(path: &Path, image: &RgbImage) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path)?);
    write!(file, "P6\n{} {}\n255\n", image.width, image.height)?;
    file.write_all(image.pixels.as_flattened())
}
