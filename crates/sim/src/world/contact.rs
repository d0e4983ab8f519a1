//! Contact of the hand with one cube: landing, pushing, grasping, slipping.
//!
//! All of it happens in the tool's frame, where a finger is an axis-aligned box and the cube is taken by its extent
//! along the two axes. This module does not depend on the rest of the world.

use glam::{Vec2, Vec3};

use super::tool::{FINGER_HALF_DEPTH, FINGER_HALF_HEIGHT, FINGER_THICKNESS, PALM_HALF, TIP_BELOW, Tool, to_tool_frame};
use super::{CUBE_HALF, Cube, misalignment};

/// The largest offset of a grasped cube's centre from the middle of the pads, across the closing axis.
const GRASP_ACROSS: f32 = 0.016;
/// The largest rotation of a grasped cube against the pads.
const GRASP_TURN: f32 = 0.38;
/// The smallest depth of the finger tips below the cube's top for a grasp.
const GRASP_DEPTH: f32 = 0.014;
/// The distance that a badly squeezed cube slips out per substep.
const SLIP: f32 = 0.004;
/// Share of its misalignment that a pushed cube keeps per substep: a flat pad turns it flush.
const TURN_KEPT: f32 = 0.9;

/// The effect of the fingers on the cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Touch {
    /// None, or a push.
    Free,
    /// A grasp.
    Grasped,
}

/// The cube's half extent along the tool's axes.
fn extent(turn: f32) -> f32 {
    CUBE_HALF * (turn.cos().abs() + turn.sin().abs())
}

/// A downward face of the hand: how far below the tool point, how deep across the closing axis, and from where to
/// where along it.
struct Sole<'a> {
    below: f32,
    half_depth: f32,
    spans: &'a [(f32, f32)],
}

/// Stops a descending tool whose finger tips or palm come down on the cube's top.
pub(super) fn land_hand(tool: &mut Tool, cube: &Cube, z_before: f32) {
    let inner = tool.width / 2.0;
    let outer = inner + FINGER_THICKNESS;
    let tips = Sole { below: TIP_BELOW, half_depth: FINGER_HALF_DEPTH, spans: &[(inner, outer), (-outer, -inner)] };
    let palm = Sole {
        below: TIP_BELOW - 2.0 * FINGER_HALF_HEIGHT,
        half_depth: PALM_HALF.y,
        spans: &[(-PALM_HALF.x, PALM_HALF.x)],
    };
    for sole in [tips, palm] {
        land_sole(tool, cube, z_before, &sole);
    }
}

fn land_sole(tool: &mut Tool, cube: &Cube, z_before: f32, sole: &Sole) {
    let top = cube.position.z + CUBE_HALF;
    let (z, before) = (tool.position.z - sole.below, z_before - sole.below);
    if z >= top || before < top {
        return;
    }
    let centre = to_tool_frame(tool, cube.position);
    let half = extent(misalignment(tool.yaw, cube.yaw));
    if centre.y.abs() >= half + sole.half_depth {
        return;
    }
    let over = sole.spans.iter().any(|&(low, high)| centre.x + half > low && centre.x - half < high);
    if over {
        tool.position.z = top + sole.below;
    }
}

/// Pushes the cube out of the fingers, or grasps it when both hold it well.
pub(super) fn push_cube(tool: &mut Tool, cube: &mut Cube) -> Touch {
    let depth = cube.position.z + CUBE_HALF - (tool.position.z - TIP_BELOW);
    let mut centre = to_tool_frame(tool, cube.position);
    let mut turn = misalignment(tool.yaw, cube.yaw);
    let half = extent(turn);
    let overlap = half + FINGER_HALF_DEPTH - centre.y.abs();
    // Fingers reach higher than a cube that lies on another has its bottom, so none is above them.
    if depth <= 0.0 || overlap <= 0.0 {
        return Touch::Free;
    }
    let inner = tool.width / 2.0;
    let outside = centre.x.abs() - inner;
    let mut touch = Touch::Free;
    if outside > FINGER_THICKNESS / 2.0 {
        let push = inner + FINGER_THICKNESS + half - centre.x.abs();
        if push <= 0.0 {
            return Touch::Free;
        }
        let push = push * centre.x.signum();
        push_least(&mut centre, &mut turn, push, overlap);
    } else {
        let right = centre.x + half - inner;
        let left = half - centre.x - inner;
        if right > 0.0 && left > 0.0 {
            touch = squeeze(tool, &mut centre, &mut turn, depth);
        } else if right > 0.0 {
            push_least(&mut centre, &mut turn, -right, overlap);
        } else if left > 0.0 {
            push_least(&mut centre, &mut turn, left, overlap);
        } else {
            return Touch::Free;
        }
    }
    place(tool, cube, centre, turn);
    touch
}

/// Both pads touch: a cube well between them is held, another slips out sideways.
fn squeeze(tool: &mut Tool, centre: &mut Vec3, turn: &mut f32, depth: f32) -> Touch {
    let well_held = centre.y.abs() <= GRASP_ACROSS && turn.abs() <= GRASP_TURN && depth >= GRASP_DEPTH;
    centre.x = 0.0;
    if well_held {
        *turn = 0.0;
        tool.width = 2.0 * CUBE_HALF;
        return Touch::Grasped;
    }
    tool.width = tool.width.max(2.0 * extent(*turn));
    centre.y += SLIP.copysign(centre.y);
    Touch::Free
}

/// Moves the cube out along the axis that needs less: along the closing axis by `along`, or across by `across`.
fn push_least(centre: &mut Vec3, turn: &mut f32, along: f32, across: f32) {
    if along.abs() <= across {
        centre.x += along;
    } else {
        centre.y += across.copysign(centre.y);
    }
    *turn *= TURN_KEPT;
}

fn place(tool: &Tool, cube: &mut Cube, centre: Vec3, turn: f32) {
    let turned = Vec2::from_angle(tool.yaw).rotate(centre.truncate());
    cube.position.x = tool.position.x + turned.x;
    cube.position.y = tool.position.y + turned.y;
    cube.yaw += turn - misalignment(tool.yaw, cube.yaw);
}
