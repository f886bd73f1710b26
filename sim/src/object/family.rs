//! The procedural families: which there are, how one is checked, drawn and built.

use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

use super::ObjectError;
use super::compound::{Ell, Hammer, Mug, Ring, Tee};
use super::convex::{Ball, Capsule, Cuboid, Cylinder, Frustum, Superquadric};
use super::revolved::{Bottle, Bowl, Can, Cup};
use super::skin::Geometry;
use super::small::{Block, Disc, Nut, Peg, Plate};

/// Smallest and largest size of anything, metres.
pub(super) const SIZES_M: (f64, f64) = (0.0005, 1.0);

/// A condition on a family's sizes: the field, its value, and the bounds (both included) it must keep.
pub(super) type Check = (&'static str, f64, f64, f64);

/// What every family can do.
pub(super) trait Solid: Sized {
    /// Conditions on the sizes; building is defined when all hold.
    fn checks(&self) -> Vec<Check>;
    /// Mesh and parts in any frame whose z is upright.
    fn geometry(&self) -> Geometry;
    /// Household sizes.
    fn draw(rng: &mut Xoshiro256PlusPlus) -> Self;
    /// Range of mass over enclosed volume, kilograms per cubic metre: what is inside is rarely solid.
    fn density() -> (f64, f64);
}

/// Draws evenly between two values.
pub(super) fn between(rng: &mut Xoshiro256PlusPlus, low: f64, high: f64) -> f64 {
    rng.random_range(low..high)
}

/// A size that only has to be a size.
pub(super) fn size(field: &'static str, value: f64) -> Check {
    (field, value, SIZES_M.0, SIZES_M.1)
}

macro_rules! families {
    ($($(#[$doc:meta])* $variant:ident($solid:ty) = $name:literal,)*) => {
        /// An object's shape by its sizes. In JSON: `{"cylinder": {"radius_m": 0.03, "height_m": 0.1}}`.
        #[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum Family {
            $($(#[$doc])* $variant($solid),)*
        }

        /// The name of a family.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum Kind {
            $($(#[$doc])* $variant,)*
        }

        impl Kind {
            /// Every family.
            pub const ALL: &[Self] = &[$(Self::$variant,)*];

            /// As in scene files, for example `mug`.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// A member with household sizes.
            pub(super) fn draw(self, rng: &mut Xoshiro256PlusPlus) -> Family {
                match self { $(Self::$variant => Family::$variant(<$solid>::draw(rng)),)* }
            }

            /// Range of mass over enclosed volume, kilograms per cubic metre.
            pub(super) fn density(self) -> (f64, f64) {
                match self { $(Self::$variant => <$solid>::density(),)* }
            }
        }

        impl Family {
            /// Which family.
            pub fn kind(&self) -> Kind {
                match self { $(Self::$variant(_) => Kind::$variant,)* }
            }

            fn checks(&self) -> Vec<Check> {
                match self { $(Self::$variant(solid) => solid.checks(),)* }
            }

            fn unchecked_geometry(&self) -> Geometry {
                match self { $(Self::$variant(solid) => solid.geometry(),)* }
            }
        }
    };
}

families! {
    /// A box.
    Box(Cuboid) = "box",
    /// A cylinder that stands.
    Cylinder(Cylinder) = "cylinder",
    /// A sphere.
    Sphere(Ball) = "sphere",
    /// A capsule that lies along x.
    Capsule(Capsule) = "capsule",
    /// A cone without its tip.
    Frustum(Frustum) = "frustum",
    /// A superquadric.
    Superquadric(Superquadric) = "superquadric",
    /// A can with bevelled edges.
    Can(Can) = "can",
    /// A bottle with shoulder and neck, filled.
    Bottle(Bottle) = "bottle",
    /// A hollow, open cup.
    Cup(Cup) = "cup",
    /// A hollow, open bowl.
    Bowl(Bowl) = "bowl",
    /// A cup with a handle.
    Mug(Mug) = "mug",
    /// A hammer that lies.
    Hammer(Hammer) = "hammer",
    /// An L-shaped piece that lies.
    Ell(Ell) = "ell",
    /// A T-shaped piece that lies.
    Tee(Tee) = "tee",
    /// A round ring that lies.
    Ring(Ring) = "ring",
    /// A thin rectangular plate that lies.
    Plate(Plate) = "plate",
    /// A thin round plate that lies.
    Disc(Disc) = "disc",
    /// A hexagonal nut.
    Nut(Nut) = "nut",
    /// A small pin that stands.
    Peg(Peg) = "peg",
    /// A small building block.
    Block(Block) = "block",
}

impl Family {
    /// Mesh and parts.
    pub(super) fn geometry(&self) -> Result<Geometry, ObjectError> {
        for (field, value, low, high) in self.checks() {
            // A NaN is within no bounds.
            if !(low..=high).contains(&value) {
                return Err(ObjectError::Size {
                    field: format!("{}.{field}", self.kind().name()),
                    found: value,
                    low,
                    high,
                });
            }
        }
        Ok(self.unchecked_geometry())
    }
}
