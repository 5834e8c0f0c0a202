!> Pads and what passes leave behind, put aside while something else is mapped to the nodes and back; a run does not feel it
module gimp_aside
  use gimp_kinds, only: wp, dp
  use gimp_grid, only: nf => fields_per_node
  use gimp_engine, only: engine_t, spill_t
  implicit none(type, external)
  private
  public :: aside_t, put_aside, bring_back

  type :: aside_t
    real(wp), pointer, contiguous, private :: pad(:, :, :) => null()
    logical, allocatable, private :: drifted(:), restless(:)
    real(dp), allocatable, private :: sums(:, :)
    real(wp), allocatable, private :: peaks(:, :)
    integer, allocatable, private :: fate(:, :)
    type(spill_t), private :: spill
  end type aside_t

contains

  !> Empty pads take the place of those of the step; nodal values stay
  subroutine put_aside(engine, aside)
    type(engine_t), intent(inout) :: engine
    type(aside_t), intent(out) :: aside
    aside%pad => engine%pad
    allocate (aside%drifted, source=engine%drifted)
    allocate (aside%restless, source=engine%restless)
    allocate (aside%sums, source=engine%sums)
    allocate (aside%peaks, source=engine%peaks)
    allocate (aside%fate, source=engine%fate)
    aside%spill = engine%spill
    engine%spill%n = 0
    allocate (engine%pad(nf, size(aside%pad, 2), size(aside%pad, 3)), source=0.0_wp)
  end subroutine put_aside

  !> All is again as it was
  subroutine bring_back(engine, aside)
    type(engine_t), intent(inout) :: engine
    type(aside_t), intent(inout) :: aside
    deallocate (engine%pad)
    engine%pad => aside%pad
    engine%drifted = aside%drifted
    engine%restless = aside%restless
    engine%sums = aside%sums
    engine%peaks = aside%peaks
    engine%fate = aside%fate
    engine%spill = aside%spill
  end subroutine bring_back

end module gimp_aside
