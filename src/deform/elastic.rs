//! A small linear-elastic solver on a lattice of nodes: a simulation as a map's source, as
//! \[DDM06\] (section 1) and \[DS07\] (section 4) propose.
//!
//! Nodes are joined to their 26 neighbours. A joint resists stretch along its own direction and,
//! less strongly, any other relative displacement. Some nodes are fixed, some are dragged; joints
//! that cross a cut are removed. The energy is quadratic in the displacements, hence there is one
//! equilibrium, and conjugate gradients find it in steps that can be shown live. (A failed attempt:
//! position-based dynamics with distance constraints. They are also satisfied inside out, hence a
//! dragged node passes through its neighbours.) The only claim is that the result looks elastic;
//! [`Solver::energy`] and [`Solver::residual`] report the convergence.
//!
//! Sums run in a fixed order: the same input gives the same result.

use glam::{DVec3, Vec3};

/// A dragged region.
#[derive(Clone, Copy, Debug)]
pub struct Grab {
    /// Centre, box mm.
    pub center: Vec3,
    /// Radius of the held region, mm.
    pub radius: f32,
    /// The displacement applied.
    pub offset: Vec3,
}

/// A circular disc across which no nodes are joined.
#[derive(Clone, Copy, Debug)]
pub struct Incision {
    /// Centre, box mm.
    pub center: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Radius, mm.
    pub radius: f32,
}

/// The input of a simulation.
pub struct Setup<'a> {
    /// Extent of the box, mm.
    pub size_mm: Vec3,
    /// Nodes along x, y, z.
    pub nodes: [usize; 3],
    /// Dragged regions.
    pub grabs: &'a [Grab],
    /// Regions held in place in addition to the box's faces: centre and radius.
    pub fixed: &'a [(Vec3, f32)],
    /// Cuts.
    pub incisions: &'a [Incision],
    /// Stiffness at a point, relative to 1.
    pub stiffness: &'a dyn Fn(Vec3) -> f32,
}

/// Resistance to displacement across a joint, as a fraction of that along it.
const SHEAR: f64 = 0.25;

struct Joint {
    a: usize,
    b: usize,
    /// Unit vector from a to b.
    along: DVec3,
    stiffness: f64,
}

impl Joint {
    /// Force on b for a displacement of b relative to a, without its sign.
    fn force(&self, relative: DVec3) -> DVec3 {
        (self.along * relative.dot(self.along) + relative * SHEAR) * self.stiffness
    }
}

/// The state of a simulation.
pub struct Solver {
    size_mm: Vec3,
    nodes: [usize; 3],
    displacement: Vec<DVec3>,
    free: Vec<bool>,
    joints: Vec<Joint>,
    incisions: Vec<Incision>,
    /// Remaining unbalanced forces on the free nodes.
    unbalanced: Vec<DVec3>,
    direction: Vec<DVec3>,
    /// Norm of the unbalanced forces at the start.
    start: f64,
    /// Number of nodes held by each grab.
    caught: Vec<usize>,
}

fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

impl Solver {
    /// A lattice at rest except for its dragged nodes.
    pub fn new(setup: &Setup) -> Self {
        let [nx, ny, nz] = setup.nodes;
        let step = setup.size_mm / Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32);
        let at = |n: usize| [n % nx, n / nx % ny, n / (nx * ny)];
        let place = |n: usize| Vec3::from(at(n).map(|c| c as f32)) * step - setup.size_mm / 2.0;
        let count = nx * ny * nz;
        let mut displacement = vec![DVec3::ZERO; count];
        let mut free = vec![true; count];
        let mut caught = vec![0usize; setup.grabs.len()];
        for n in 0..count {
            let (c, p) = (at(n), place(n));
            let on_face = (0..3).any(|a| c[a] == 0 || c[a] + 1 == setup.nodes[a]);
            free[n] = !on_face
                && !setup
                    .fixed
                    .iter()
                    .any(|(center, radius)| p.distance(*center) <= *radius);
            if let Some(g) = setup.grabs.iter().position(|g| p.distance(g.center) <= g.radius)
                && free[n]
            {
                free[n] = false;
                displacement[n] = setup.grabs[g].offset.as_dvec3();
                caught[g] += 1;
            }
        }
        // A region smaller than a cell holds the nearest node, if one lies within a cell.
        for (g, grab) in setup.grabs.iter().enumerate() {
            if caught[g] > 0 {
                continue;
            }
            let nearest = (0..count).filter(|n| free[*n]).min_by(|a, b| {
                place(*a)
                    .distance_squared(grab.center)
                    .total_cmp(&place(*b).distance_squared(grab.center))
            });
            if let Some(n) = nearest.filter(|n| (place(*n) - grab.center).abs().cmple(step).all()) {
                free[n] = false;
                displacement[n] = grab.offset.as_dvec3();
                caught[g] = 1;
            }
        }
        let crosses = |a: Vec3, b: Vec3| {
            setup.incisions.iter().any(|i| {
                let (da, db) = ((a - i.center).dot(i.normal), (b - i.center).dot(i.normal));
                // A node on the plane itself belongs to its upper side.
                (da < 0.0) != (db < 0.0) && (a.lerp(b, da / (da - db)) - i.center).length() <= i.radius
            })
        };
        let neighbours: Vec<[i32; 3]> = (-1..=1)
            .flat_map(|z| (-1..=1).flat_map(move |y| (-1..=1).map(move |x| [x, y, z])))
            .skip(14)
            .collect();
        let mut joints = Vec::with_capacity(13 * count);
        for n in 0..count {
            let c = at(n);
            for d in &neighbours {
                let m: [i64; 3] = std::array::from_fn(|a| c[a] as i64 + i64::from(d[a]));
                if (0..3).any(|a| m[a] < 0 || m[a] >= setup.nodes[a] as i64) {
                    continue;
                }
                let m = (m[2] as usize * ny + m[1] as usize) * nx + m[0] as usize;
                let (a, b) = (place(n), place(m));
                if !(free[n] || free[m]) || crosses(a, b) {
                    continue;
                }
                let way = (b - a).as_dvec3();
                let stiffness = f64::from((setup.stiffness)(a.lerp(b, 0.5)).max(1e-3)) / way.length_squared();
                joints.push(Joint {
                    a: n,
                    b: m,
                    along: way.normalize_or_zero(),
                    stiffness,
                });
            }
        }
        let mut solver = Self {
            size_mm: setup.size_mm,
            nodes: setup.nodes,
            displacement,
            free,
            joints,
            incisions: setup.incisions.to_vec(),
            unbalanced: Vec::new(),
            direction: Vec::new(),
            start: 0.0,
            caught,
        };
        solver.unbalanced = solver.forces(&solver.displacement);
        solver.direction = solver.unbalanced.clone();
        solver.start = dot(&solver.unbalanced, &solver.unbalanced).sqrt();
        solver
    }

    /// Forces on the free nodes for displacements `u`.
    fn forces(&self, u: &[DVec3]) -> Vec<DVec3> {
        let mut f = vec![DVec3::ZERO; u.len()];
        for j in &self.joints {
            let force = j.force(u[j.b] - u[j.a]);
            f[j.a] += force;
            f[j.b] -= force;
        }
        f.iter_mut()
            .zip(&self.free)
            .filter(|(_, free)| !**free)
            .for_each(|(f, _)| *f = DVec3::ZERO);
        f
    }

    /// One iteration of conjugate gradients towards equilibrium.
    pub fn step(&mut self) {
        let before = dot(&self.unbalanced, &self.unbalanced);
        if before <= 0.0 {
            return;
        }
        // The stiffness matrix times the direction is minus the forces of that direction.
        let made = self.forces(&self.direction);
        let curvature = -dot(&self.direction, &made);
        if curvature <= 0.0 {
            return;
        }
        let length = before / curvature;
        for (u, d) in self.displacement.iter_mut().zip(&self.direction) {
            *u += *d * length;
        }
        for (r, m) in self.unbalanced.iter_mut().zip(&made) {
            *r += *m * length;
        }
        let share = dot(&self.unbalanced, &self.unbalanced) / before;
        for (d, r) in self.direction.iter_mut().zip(&self.unbalanced) {
            *d = *r + *d * share;
        }
    }

    /// Iterates until the unbalanced forces are below `residual` of those at the start, or for
    /// `most` steps; returns the number of steps.
    pub fn settle(&mut self, most: usize, residual: f64) -> usize {
        (0..most)
            .find(|_| {
                let done = self.residual() <= residual;
                if !done {
                    self.step();
                }
                done
            })
            .unwrap_or(most)
    }

    /// Elastic energy, in the solver's units.
    pub fn energy(&self) -> f64 {
        let relative = |j: &Joint| self.displacement[j.b] - self.displacement[j.a];
        self.joints
            .iter()
            .map(|j| 0.5 * relative(j).dot(j.force(relative(j))))
            .sum()
    }

    /// Unbalanced forces, as a fraction of those at the start.
    pub fn residual(&self) -> f64 {
        if self.start > 0.0 {
            dot(&self.unbalanced, &self.unbalanced).sqrt() / self.start
        } else {
            0.0
        }
    }

    /// Displacement of the nodes, trilinearly interpolated; zero outside the box.
    pub fn displacement(&self, p: DVec3) -> DVec3 {
        let [nx, ny, nz] = self.nodes;
        let top = DVec3::new((nx - 1) as f64, (ny - 1) as f64, (nz - 1) as f64);
        let g = ((p / self.size_mm.as_dvec3() + 0.5) * top).clamp(DVec3::ZERO, top);
        let base = g.floor().min(top - 1.0).max(DVec3::ZERO);
        let f = g - base;
        let mut sum = DVec3::ZERO;
        for corner in 0..8usize {
            let (a, b, c) = (corner & 1, corner >> 1 & 1, corner >> 2);
            let n = ((base.z as usize + c) * ny + base.y as usize + b) * nx + base.x as usize + a;
            let weight = |bit: usize, t: f64| if bit == 1 { t } else { 1.0 - t };
            sum += self.displacement[n] * (weight(a, f.x) * weight(b, f.y) * weight(c, f.z));
        }
        sum
    }

    /// Number of nodes held by each grab.
    pub fn caught(&self) -> &[usize] {
        &self.caught
    }

    /// The cuts.
    pub fn incisions(&self) -> &[Incision] {
        &self.incisions
    }

    /// Distance between nodes along a direction, mm.
    pub fn spacing_along(&self, direction: Vec3) -> f32 {
        let [nx, ny, nz] = self.nodes;
        let step = self.size_mm / Vec3::new((nx - 1) as f32, (ny - 1) as f32, (nz - 1) as f32);
        (direction.abs() * step).element_sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solver(grabs: &[Grab], incisions: &[Incision]) -> Solver {
        Solver::new(&Setup {
            size_mm: Vec3::splat(60.0),
            nodes: [13; 3],
            grabs,
            fixed: &[],
            incisions,
            stiffness: &|_| 1.0,
        })
    }

    const GRAB: Grab = Grab {
        center: Vec3::ZERO,
        radius: 8.0,
        offset: Vec3::new(0.0, 0.0, 9.0),
    };

    #[test]
    fn nothing_dragged_stays_at_rest() {
        let mut s = solver(&[], &[]);
        assert_eq!((s.settle(20, 1e-9), s.energy(), s.residual()), (0, 0.0, 0.0));
    }

    #[test]
    fn what_is_dragged_follows_and_the_energy_falls() {
        let mut s = solver(&[GRAB], &[]);
        let start = s.energy();
        let steps = s.settle(200, 1e-6);
        println!("{steps} steps, energy {start} to {}", s.energy());
        assert!(steps < 200, "it does not come to rest");
        assert!(s.energy() < start);
        // The equilibrium has the least energy: any other position of any free node has more.
        let least = s.energy();
        for n in (0..s.displacement.len()).filter(|n| s.free[*n]).step_by(37) {
            s.displacement[n] += DVec3::new(0.01, -0.02, 0.015);
            assert!(s.energy() > least);
            s.displacement[n] -= DVec3::new(0.01, -0.02, 0.015);
        }
        assert!(s.displacement(DVec3::ZERO).distance(DVec3::new(0.0, 0.0, 9.0)) < 1e-9);
        let near = s.displacement(DVec3::new(0.0, 0.0, 15.0)).z;
        assert!(near > 1.0 && near < 9.0, "{near}");
        assert_eq!(s.displacement(DVec3::new(30.0, 0.0, 0.0)), DVec3::ZERO);
        // Symmetric about the axis of the pull.
        let (a, b) = (
            s.displacement(DVec3::new(12.0, 0.0, 0.0)),
            s.displacement(DVec3::new(-12.0, 0.0, 0.0)),
        );
        assert!((a.z - b.z).abs() < 1e-3, "{a} {b}");
    }

    #[test]
    fn a_uniform_strain_is_at_rest() {
        // Linear displacements are balanced in the interior of any lattice: the patch test.
        let mut s = solver(&[], &[]);
        for n in 0..13 * 13 * 13usize {
            let p = DVec3::new((n % 13) as f64, (n / 13 % 13) as f64, (n / 169) as f64);
            s.displacement[n] = DVec3::new(0.1 * p.x + 0.05 * p.y, -0.02 * p.z, 0.03 * p.x);
        }
        assert!(s.forces(&s.displacement).iter().all(|f| f.length() < 1e-12));
    }

    #[test]
    fn an_incision_parts_what_is_pulled_aside() {
        let cut = Incision {
            center: Vec3::ZERO,
            normal: Vec3::X,
            radius: 22.0,
        };
        let pull = Grab {
            center: Vec3::new(7.5, 0.0, 0.0),
            radius: 6.0,
            offset: Vec3::new(6.0, 0.0, 0.0),
        };
        let (mut whole, mut parted) = (solver(&[pull], &[]), solver(&[pull], &[cut]));
        whole.settle(300, 1e-6);
        parted.settle(300, 1e-6);
        let left = DVec3::new(-5.0, 0.0, 10.0);
        assert!(parted.displacement(left).x.abs() < 0.5 * whole.displacement(left).x.abs());
    }
}
