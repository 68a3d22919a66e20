//! The solver of quadratic programs against the conditions of a minimum, and against a linear program where there is none.

use fiatlux_kinematics::{Program, ProgramError, ProgramSolver};

use crate::Draws;

/// A random program of 2 to 20 variables and up to 40 rows.
struct Random {
    hessian: Vec<f64>,
    gradient: Vec<f64>,
    rows: Vec<f64>,
    bounds: Vec<f64>,
    equalities: usize,
}

impl Random {
    /// With a point that meets all rows if `feasible`, otherwise with random bounds.
    fn new(seed: u64, feasible: bool) -> Self {
        let mut draws = Draws(seed);
        let mut whole =
            |low: usize, high: usize| low + (((draws.one() + 1.0) / 2.0) * (high - low + 1) as f64) as usize;
        let (n, more) = (whole(2, 20), whole(0, 30));
        let equalities = whole(0, n / 2);
        let m = equalities + more;
        let factor = draws.many(n * n, 1.0);
        let mut hessian = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..n {
                hessian[i * n + j] = (0..n).map(|k| factor[i * n + k] * factor[j * n + k]).sum::<f64>()
                    + if i == j { 0.01 } else { 0.0 };
            }
        }
        let (gradient, rows, point) = (draws.many(n, 10.0), draws.many(n * m, 1.0), draws.many(n, 3.0));
        let bounds = (0..m)
            .map(|row| {
                let value: f64 = rows[row * n..][..n].iter().zip(&point).map(|(a, b)| a * b).sum();
                match (feasible, row < equalities) {
                    (false, _) => 3.0 * draws.one(),
                    (true, true) => value,
                    // Every other one is tight at the point.
                    (true, false) => value - if row % 2 == 0 { 0.0 } else { draws.one().abs() },
                }
            })
            .collect();
        Self { hessian, gradient, rows, bounds, equalities }
    }

    fn program(&self) -> Program<'_> {
        let Self { hessian, gradient, rows, bounds, equalities } = self;
        Program { hessian, gradient, rows, bounds, equalities: *equalities }
    }

    fn slacks(&self, x: &[f64]) -> Vec<f64> {
        let of = |(row, bound): (&[f64], &f64)| row.iter().zip(x).map(|(a, b)| a * b).sum::<f64>() - bound;
        self.rows.chunks(x.len()).zip(&self.bounds).map(of).collect()
    }

    fn cost(&self, x: &[f64]) -> f64 {
        let n = x.len();
        (0..n)
            .map(|i| x[i] * (self.gradient[i] + 0.5 * (0..n).map(|j| self.hessian[i * n + j] * x[j]).sum::<f64>()))
            .sum()
    }
}

/// Another method, slow but simple: accelerated ascent of the dual.
fn by_dual_ascent(problem: &Random, n: usize) -> Vec<f64> {
    let h = nalgebra::DMatrix::from_row_slice(n, n, &problem.hessian);
    let m = problem.bounds.len();
    let a = nalgebra::DMatrix::from_row_slice(m, n, &problem.rows);
    let (g, b) = (
        nalgebra::DVector::from_column_slice(&problem.gradient),
        nalgebra::DVector::from_column_slice(&problem.bounds),
    );
    let inverse = h.cholesky().unwrap().inverse();
    let dual = &a * &inverse * a.transpose();
    let rate = 1.0 / dual.norm();
    let linear = &b + &a * &inverse * &g;
    let (mut y, mut before) = (nalgebra::DVector::zeros(m), nalgebra::DVector::zeros(m));
    for step in 0..200_000 {
        let momentum = f64::from(step % 500) / f64::from(step % 500 + 3);
        let ahead = &y + (&y - &before) * momentum;
        before.clone_from(&y);
        y = &ahead + (&linear - &dual * &ahead) * rate;
        for row in problem.equalities..m {
            y[row] = y[row].max(0.0);
        }
        if (&y - &before).norm() < 1e-13 * (1.0 + y.norm()) {
            break;
        }
    }
    (inverse * (a.transpose() * y - g)).as_slice().to_vec()
}

#[test]
fn minima_are_feasible_and_no_feasible_neighbour_is_lower() {
    let mut solver = ProgramSolver::default();
    let mut compared = 0;
    for seed in 0..2000 {
        let problem = Random::new(seed, true);
        let n = problem.gradient.len();
        let mut x = vec![0.0; n];
        solver.solve(&problem.program(), &mut x).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        let slacks = problem.slacks(&x);
        let scale = 1.0 + x.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        assert!(slacks[..problem.equalities].iter().all(|slack| slack.abs() < 1e-8 * scale), "seed {seed}: {slacks:?}");
        assert!(slacks.iter().all(|slack| *slack > -1e-8 * scale), "seed {seed}: {slacks:?}");
        // Another method finds no lower point.
        if seed % 20 == 0 {
            let other = by_dual_ascent(&problem, n);
            let worst = problem.slacks(&other).iter().fold(0.0_f64, |most, slack| most.max(-slack));
            if worst < 1e-7 * scale {
                compared += 1;
                let gap = problem.cost(&x) - problem.cost(&other);
                assert!(gap < 1e-5 * (1.0 + problem.cost(&x).abs()), "seed {seed}: {gap} above another point");
            }
        }
    }
    assert!(compared > 50, "only {compared} compared");
}

/// Rows that repeat others are met, rows that contradict them are refused by name.
#[test]
fn dependent_rows() {
    let mut solver = ProgramSolver::default();
    let program = |rows: &'static [f64], bounds: &'static [f64], equalities| Program {
        hessian: &[2.0, 0.0, 0.0, 2.0],
        gradient: &[0.0, 0.0],
        rows,
        bounds,
        equalities,
    };
    let mut x = [0.0; 2];
    solver.solve(&program(&[1.0, 1.0, 2.0, 2.0, -1.0, -1.0], &[1.0, 2.0, -1.0], 2), &mut x).unwrap();
    assert!((x[0] - 0.5).abs() < 1e-12 && (x[1] - 0.5).abs() < 1e-12);
    let twice = solver.solve(&program(&[1.0, 1.0, 1.0, 1.0], &[1.0, 2.0], 2), &mut x);
    assert_eq!(twice, Err(ProgramError::Infeasible { row: 1 }));
    let beyond = solver.solve(&program(&[1.0, 0.0, -1.0, 0.0], &[1.0, 0.0], 0), &mut x);
    assert!(matches!(beyond, Err(ProgramError::Infeasible { .. })), "{beyond:?}");
    let saddle = Program { hessian: &[1.0, 0.0, 0.0, -1.0], ..program(&[], &[], 0) };
    assert_eq!(solver.solve(&saddle, &mut x), Err(ProgramError::NotConvex));
    let nan = Program { gradient: &[f64::NAN, 0.0], ..program(&[1.0, 0.0], &[1.0], 0) };
    assert!(solver.solve(&nan, &mut x).is_err());
}

/// Where random bounds have no solution, a linear program has none either, and the other way round.
#[test]
fn it_is_infeasible_where_a_linear_program_is() {
    let mut solver = ProgramSolver::default();
    let mut counts = [0; 2];
    for seed in 0..500 {
        let problem = Random::new(seed, false);
        let mut x = vec![0.0; problem.gradient.len()];
        let solved = solver.solve(&problem.program(), &mut x).is_ok();
        let (rows, bounds) = (&problem.rows, &problem.bounds);
        assert_eq!(solved, crate::stances::is_feasible(x.len(), rows, bounds, problem.equalities), "seed {seed}");
        counts[usize::from(solved)] += 1;
    }
    println!("{} of 500 have no solution", counts[0]);
    assert!(counts.iter().all(|count| *count > 50), "{counts:?}");
}
