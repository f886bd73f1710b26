//! Everything in a world that a camera can see, as pieces to rasterize.

use std::borrow::Cow;

use nalgebra::{Isometry3, Point3, Vector3};

use super::raster::Piece;
use super::solids::{self, Triangles};
use super::{BACKGROUND, FIRST_HAND};
use crate::mesh::Mesh;
use crate::object::Surface;
use crate::world::World;

/// How thick the table is drawn, metres.
const TABLE_THICKNESS_M: f64 = 0.1;
/// What a depth camera gets back from a hand: anodized aluminium and grey plastic.
const HAND_SURFACE: Surface = Surface { albedo: 0.4, specular: 0.1 };

/// What a piece belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Table,
    Tray,
    Object(u32),
    Hand,
}

/// One thing with triangles of its own, or borrowed from the world.
#[derive(Debug)]
struct Part<'a> {
    kind: Kind,
    id: u16,
    vertices: Cow<'a, [Point3<f64>]>,
    triangles: Cow<'a, [[u32; 3]]>,
    world_from_part: Isometry3<f64>,
    surface: Surface,
}

/// What there is to see in a world at one moment.
#[derive(Debug)]
pub(crate) struct Sight<'a> {
    parts: Vec<Part<'a>>,
}

impl<'a> Sight<'a> {
    /// Table, tray, objects and hands as they are now.
    pub(crate) fn of(world: &'a World) -> Self {
        let settings = world.settings();
        let mut sight = Self { parts: Vec::new() };
        let half = settings.table_half_extent_m;
        sight.slab(
            Kind::Table,
            Vector3::new(0.0, 0.0, -TABLE_THICKNESS_M / 2.0),
            Vector3::new(half, half, TABLE_THICKNESS_M / 2.0),
            settings.table_surface,
        );
        for (center, half) in settings.tray.iter().flat_map(|t| t.walls()) {
            sight.slab(Kind::Tray, center, half, settings.table_surface);
        }
        for id in world.ids() {
            let (Some(object), Some(world_from_part)) = (world.object(id), world.pose(id)) else { continue };
            sight.parts.push(Part {
                kind: Kind::Object(id.number()),
                id: u16::try_from(id.number()).unwrap_or(u16::MAX).min(FIRST_HAND - 1),
                vertices: object.mesh.vertices.as_slice().into(),
                triangles: object.mesh.triangles.as_slice().into(),
                world_from_part,
                surface: object.surface,
            });
        }
        for (index, id) in world.hand_ids().into_iter().enumerate() {
            let (Some(hand), Some(links)) = (world.hand(id), world.hand_links(id)) else { continue };
            let number = u16::try_from(index).map_or(u16::MAX, |i| FIRST_HAND.saturating_add(i));
            for visual in &hand.visuals {
                let Some(world_from_link) = links.get(visual.link) else { continue };
                let Triangles { vertices, triangles } = solids::triangulate(&visual.shape);
                sight.parts.push(Part {
                    kind: Kind::Hand,
                    id: number,
                    vertices,
                    triangles,
                    world_from_part: world_from_link * visual.link_from_shape,
                    surface: HAND_SURFACE,
                });
            }
        }
        sight
    }

    fn slab(&mut self, kind: Kind, center: Vector3<f64>, half: Vector3<f64>, surface: Surface) {
        let mesh = Mesh::cuboid(half);
        self.parts.push(Part {
            kind,
            id: BACKGROUND,
            vertices: mesh.vertices.into(),
            triangles: mesh.triangles.into(),
            world_from_part: Isometry3::translation(center.x, center.y, center.z),
            surface,
        });
    }

    /// For the rasterizer, in the order of [`Sight::kind`].
    pub(crate) fn pieces(&self) -> Vec<Piece<'_>> {
        self.parts
            .iter()
            .map(|p| Piece {
                vertices: &p.vertices,
                triangles: &p.triangles,
                world_from_piece: p.world_from_part,
                id: p.id,
                surface: p.surface,
            })
            .collect()
    }

    /// What a piece belongs to.
    pub(crate) fn kind(&self, piece: u32) -> Option<Kind> {
        self.parts.get(piece as usize).map(|p| p.kind)
    }

    /// What a piece gives back of light.
    pub(crate) fn surface(&self, piece: u32) -> Option<Surface> {
        self.parts.get(piece as usize).map(|p| p.surface)
    }
}
