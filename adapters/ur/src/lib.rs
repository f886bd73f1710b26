//! Universal Robots arms (CB3 and e-Series) for a graspd cell.

pub mod kinematics;
