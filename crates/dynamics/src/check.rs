//! Checks of bodies and shapes.

use nalgebra::SymmetricEigen;

use crate::error::ModelError;
use crate::spec::{BodySpec, Joint, ShapeSpec};

pub(crate) fn check_value(
    part: &'static str,
    name: &str,
    field: &'static str,
    value: f64,
    ok: bool,
    rule: &'static str,
) -> Result<(), ModelError> {
    if ok { Ok(()) } else { Err(ModelError::Value { part, name: name.into(), field, value, rule }) }
}

pub(crate) fn check_finite(
    part: &'static str,
    name: &str,
    field: &'static str,
    values: &[f64],
) -> Result<(), ModelError> {
    for &value in values {
        check_value(part, name, field, value, value.is_finite(), "it must be finite")?;
    }
    Ok(())
}

pub(crate) fn check_body(spec: &BodySpec) -> Result<(), ModelError> {
    let check = |field, value: f64, ok, rule| check_value("body", &spec.name, field, value, ok, rule);
    check("mass", spec.mass, spec.mass > 0.0 && spec.mass.is_finite(), "it must be positive and finite")?;
    check_finite("body", &spec.name, "com", spec.com.as_slice())?;
    check_finite("body", &spec.name, "inertia", spec.inertia.as_slice())?;
    check_finite("body", &spec.name, "parent_from_body", spec.parent_from_body.translation.vector.as_slice())?;
    check_finite("body", &spec.name, "parent_from_body", spec.parent_from_body.rotation.coords.as_slice())?;
    let asymmetry = (spec.inertia - spec.inertia.transpose()).amax();
    check("inertia", asymmetry, asymmetry <= 1e-9 * spec.inertia.amax(), "the matrix must be symmetric")?;
    let mut moments: Vec<f64> = SymmetricEigen::new(spec.inertia).eigenvalues.iter().copied().collect();
    moments.sort_by(f64::total_cmp);
    check("inertia", moments[0], moments[0] > 0.0, "every principal moment must be positive")?;
    // Published figures are rounded, so the triangle inequality may be missed by a little.
    let excess = moments[2] - moments[0] - moments[1];
    check(
        "inertia",
        excess,
        excess <= 0.01 * moments[2],
        "the largest principal moment exceeds the sum of the others by this",
    )?;
    if let Joint::Hinge(hinge) = &spec.joint {
        check_finite("body", &spec.name, "axis", hinge.axis.as_slice())?;
        check("lower", hinge.lower, hinge.lower < hinge.upper, "it must be below the upper limit")?;
        check(
            "armature",
            hinge.armature,
            hinge.armature >= 0.0 && hinge.armature.is_finite(),
            "it must not be negative",
        )?;
        if let Some(drive) = hinge.drive {
            let gain = |g: f64| g >= 0.0 && g.is_finite();
            check("stiffness", drive.stiffness, gain(drive.stiffness), "it must not be negative")?;
            check("damping", drive.damping, gain(drive.damping), "it must not be negative")?;
            check("effort_limit", drive.effort_limit, drive.effort_limit > 0.0, "it must be positive")?;
            check("speed_limit", drive.speed_limit, drive.speed_limit > 0.0, "it must be positive")?;
        }
    }
    Ok(())
}

pub(crate) fn check_shape(spec: &ShapeSpec) -> Result<(), ModelError> {
    let positive = |field, value: f64| {
        check_value(
            "shape",
            &spec.name,
            field,
            value,
            value > 0.0 && value.is_finite(),
            "it must be positive and finite",
        )
    };
    check_finite("shape", &spec.name, "body_from_shape", spec.body_from_shape.translation.vector.as_slice())?;
    check_finite("shape", &spec.name, "body_from_shape", spec.body_from_shape.rotation.coords.as_slice())?;
    for (field, size) in spec.geometry.sizes() {
        positive(field, size)?;
    }
    for (field, lever) in [("torsion", spec.material.torsion), ("rolling", spec.material.rolling)] {
        let ok = lever >= 0.0 && lever.is_finite();
        check_value("shape", &spec.name, field, lever, ok, "it must be finite and not negative")?;
    }
    check_friction(&spec.name, spec.material.friction)
}

pub(crate) fn check_friction(shape: &str, friction: f64) -> Result<(), ModelError> {
    let ok = friction >= 0.0 && friction.is_finite();
    check_value("shape", shape, "friction", friction, ok, "it must be finite and not negative")
}
