//! Dockable panels and their arrangements.

use egui_dock::{DockState, NodeIndex};
use serde::{Deserialize, Serialize};

/// A panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[allow(missing_docs, reason = "each is described by its title")]
pub enum Panel {
    View3d,
    Axial,
    Coronal,
    Sagittal,
    Scene,
    Inspector,
    Transfer,
    Compare,
    Measure,
    MapEditor,
    Log,
}

impl Panel {
    /// All panels.
    pub const ALL: [Self; 11] = [
        Self::View3d,
        Self::Axial,
        Self::Coronal,
        Self::Sagittal,
        Self::Scene,
        Self::Inspector,
        Self::Transfer,
        Self::Compare,
        Self::Measure,
        Self::MapEditor,
        Self::Log,
    ];

    /// Its title.
    pub fn title(self) -> &'static str {
        match self {
            Self::View3d => "3D",
            Self::Axial => "Axial",
            Self::Coronal => "Coronal",
            Self::Sagittal => "Sagittal",
            Self::Scene => "Scene",
            Self::Inspector => "Inspector",
            Self::Transfer => "Transfer",
            Self::Compare => "Compare",
            Self::Measure => "Measure",
            Self::MapEditor => "Maps",
            Self::Log => "Log",
        }
    }
}

/// An arrangement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LayoutPreset {
    /// The 3D view, large, next to the panels.
    Only3d,
    /// The 3D view above three slices, next to the panels.
    FourUp,
    /// The comparison, large; the 3D view is a tab next to the scene.
    Compare,
}

impl LayoutPreset {
    /// The dock with the panels in their places.
    pub fn dock(self) -> DockState<Panel> {
        use Panel as P;
        match self {
            Self::Only3d => {
                let mut dock = DockState::new(vec![P::View3d]);
                let tree = dock.main_surface_mut();
                let [main, side] = tree.split_right(
                    NodeIndex::root(),
                    0.79,
                    vec![P::Inspector, P::Measure, P::MapEditor, P::Log],
                );
                tree.split_below(side, 0.56, vec![P::Transfer]);
                tree.split_left(main, 0.19, vec![P::Scene]);
                dock
            }
            Self::FourUp => {
                let mut dock = DockState::new(vec![P::View3d]);
                let tree = dock.main_surface_mut();
                let [main, side] = tree.split_right(
                    NodeIndex::root(),
                    0.815,
                    vec![P::Inspector, P::Measure, P::MapEditor, P::Log],
                );
                tree.split_below(side, 0.55, vec![P::Transfer]);
                let [main, _scene] = tree.split_left(main, 0.16, vec![P::Scene]);
                let [_, axial] = tree.split_below(main, 0.64, vec![P::Axial]);
                let [_, coronal] = tree.split_right(axial, 1.0 / 3.0, vec![P::Coronal]);
                tree.split_right(coronal, 0.5, vec![P::Sagittal]);
                dock
            }
            Self::Compare => {
                let mut dock = DockState::new(vec![P::Compare]);
                let tree = dock.main_surface_mut();
                let [main, side] =
                    tree.split_right(NodeIndex::root(), 0.8, vec![P::Inspector, P::Measure, P::Log]);
                tree.split_below(side, 0.55, vec![P::Transfer]);
                tree.split_left(main, 0.185, vec![P::Scene, P::View3d]);
                dock
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_arrangement_shows_a_picture_and_the_scene() {
        for preset in [LayoutPreset::Only3d, LayoutPreset::FourUp, LayoutPreset::Compare] {
            let dock = preset.dock();
            let shown: Vec<Panel> = dock.iter_all_tabs().map(|(_, p)| *p).collect();
            assert!(
                shown.contains(&Panel::Scene)
                    && shown.contains(&Panel::Inspector)
                    && shown.contains(&Panel::Transfer)
            );
            assert!(shown.contains(&Panel::View3d));
        }
    }
}
