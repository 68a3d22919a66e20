//! Coarser versions of a surface.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::surface::Surface;

/// Factor by which a cell grows from one try to the next.
const GROWTH: f64 = 1.12;

impl Surface {
    /// A surface of at most `most` faces; none where this one has no more. Its vertices are joined within the cells of a
    /// grid, which is as fine as that allows (Rossignac and Borrel 1993).
    pub(crate) fn decimated(&self, most: usize) -> Option<Self> {
        if self.faces.len() <= most {
            return None;
        }
        let area: f64 = self.faces.iter().map(|face| self.area(*face).norm() / 2.0).sum();
        // Two faces a cell would fill it; a wrinkled surface has more.
        let mut cell = (area / most as f64).sqrt();
        loop {
            let coarse = self.clustered(cell);
            // Dust vanishes before it is little enough: then the largest faces stand for all.
            if coarse.faces.len() < most / 8 {
                return Some(self.largest(most));
            }
            if coarse.faces.len() <= most {
                return Some(coarse);
            }
            cell *= GROWTH;
        }
    }

    fn clustered(&self, cell: f64) -> Self {
        let mut cells = BTreeMap::new();
        let mut points: Vec<(Vector3<f64>, f64)> = Vec::new();
        let index_of: Vec<u32> = self
            .points
            .iter()
            .map(|p| {
                let key = [p.x, p.y, p.z].map(|value| libm::floor(value / cell) as i64);
                *cells.entry(key).or_insert_with(|| {
                    points.push((Vector3::zeros(), 0.0));
                    points.len() as u32 - 1
                })
            })
            .collect();
        // A vertex counts by the area around it.
        for face in &self.faces {
            let weight = self.area(*face).norm();
            for i in face {
                let (sum, weights) = &mut points[index_of[*i as usize] as usize];
                *sum += self.points[*i as usize] * weight;
                *weights += weight;
            }
        }
        let points = points.into_iter().map(|(sum, weights)| sum / weights.max(f64::MIN_POSITIVE)).collect();
        let faces = self.faces.iter().map(|face| face.map(|i| index_of[i as usize]));
        let faces = faces.filter(|[a, b, c]| a != b && b != c && c != a).collect();
        self.with(points, faces)
    }

    fn largest(&self, most: usize) -> Self {
        let mut order: Vec<usize> = (0..self.faces.len()).collect();
        order.sort_by(|a, b| self.area(self.faces[*b]).norm().total_cmp(&self.area(self.faces[*a]).norm()));
        order.truncate(most);
        order.sort_unstable();
        self.with(self.points.clone(), order.into_iter().map(|i| self.faces[i]).collect())
    }
}
