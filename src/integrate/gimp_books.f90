!> The books of a run: where energy came from and where it went.
!>
!> In every step  E_p' - E_p = W_forces + W_gravity + W_walls + W_damping - D_p2g - D_g2p  (algorithms: energy books). Kinetic
!> energy is that of the particles; works are those of nodal forces with the mean nodal velocity; D_p2g uses the energy that
!> the particles gave to the nodes by their weights. `residual` collects what is left: lost weights, lost particles, a wrong
!> nodal update all show in it. `e_stress` compares the work of the nodal forces with the energy of the material.
module gimp_books
  use gimp_kinds, only: dp, i8
  implicit none(type, external)
  private
  public :: books_t, close_step, energy_residual, energy_drift, stress_update_error, total_energy, momentum_residual, &
    energy_from_nothing

  integer, parameter :: n_search = 7
  real(dp), parameter :: most_gain = 0.5_dp !! energy that a sound step may gain, of what there was
  real(dp), parameter :: small_energy = 1.0e-3_dp !! of the largest energy so far: gains below half of it do not count

  !> Sums since the start, in joule (per metre in 2D, per square metre in 1D)
  type :: books_t
    real(dp) :: kinetic = 0.0_dp !! of the particles now
    real(dp) :: stored = 0.0_dp !! elastic energy now (as of the last history row)
    real(dp) :: stored_start = 0.0_dp
    real(dp) :: kinetic_start = 0.0_dp
    real(dp) :: plastic = 0.0_dp !! dissipated by plastic flow
    real(dp) :: damping = 0.0_dp !! taken out by damping
    real(dp) :: loads = 0.0_dp !! work of gravity, body forces, tractions and point forces
    real(dp) :: reactions = 0.0_dp !! work of the sides of the box
    real(dp) :: internal = 0.0_dp !! work of the internal forces
    real(dp) :: loss_p2g = 0.0_dp !! lost on the way to the grid
    real(dp) :: loss_g2p = 0.0_dp !! lost on the way back (FLIP: may be negative)
    real(dp) :: filtered = 0.0_dp !! kinetic energy that the null-space filter took, a part of loss_g2p
    real(dp) :: removed = 0.0_dp !! kinetic and stored energy of particles taken out
    real(dp) :: residual = 0.0_dp !! what the identity leaves, added up
    real(dp) :: largest = tiny(1.0_dp) !! largest energy exchanged or present: the scale of the residual
    integer(i8) :: cut_nodes = 0 !! node-steps below the mass cut-off
    real(dp) :: cut_momentum = 0.0_dp !! momentum that those nodes did not get back [kg m/s], sum of norms
    integer(i8) :: clamped = 0 !! domains shortened, particle-steps
    integer(i8) :: detached = 0 !! domains whose corners were given up
    integer(i8) :: wide_chunks = 0 !! chunk-steps through the list kernel
    integer(i8) :: spilled = 0 !! node values beyond a pad
    integer(i8) :: lost_loads = 0 !! load points on inactive nodes
    integer(i8) :: handed = 0 !! particle-steps in which light nodes handed on force
    real(dp) :: handed_impulse = 0.0_dp !! of that force [kg m/s], sum of norms
    integer(i8) :: search(n_search) = 0 !! of a mesh: elements tested beyond the own one, and so on, as the passes count them (gimp_engine)
    integer(i8) :: removed_particles = 0
    integer(i8) :: sorts = 0
    real(dp) :: momentum_start(3) = 0.0_dp !! [kg m/s]
    real(dp) :: impulse(3) = 0.0_dp !! of everything from outside since the start [kg m/s]
    real(dp) :: momentum_scale = tiny(1.0_dp) !! largest sqrt(2 E_k M) [kg m/s]
    real(dp) :: mass = 0.0_dp !! [kg]
    real(dp) :: reaction(3) = 0.0_dp !! force of the sides on the material in the last step [N]
    ! of the step in hand
    real(dp) :: grid_before = 0.0_dp, grid_after = 0.0_dp, given = 0.0_dp, work_forces = 0.0_dp, work_gravity = 0.0_dp
    real(dp) :: work_walls = 0.0_dp, work_damping = 0.0_dp, work_external = 0.0_dp, work_pushed = 0.0_dp
  end type books_t

contains

  !> Close the books of one step; `kinetic` is the energy of the particles after it
  subroutine close_step(books, kinetic)
    type(books_t), intent(inout) :: books
    real(dp), intent(in) :: kinetic
    real(dp) :: p2g, g2p, work
    p2g = books%given - books%grid_before + books%work_pushed
    g2p = books%grid_after - kinetic
    work = books%work_forces + books%work_gravity + books%work_walls + books%work_damping &
      + books%work_pushed
    books%residual = books%residual + ((kinetic - books%kinetic) - work + p2g + g2p)
    books%loss_p2g = books%loss_p2g + p2g
    books%loss_g2p = books%loss_g2p + g2p
    books%loads = books%loads + books%work_external + books%work_gravity
    books%internal = books%internal + (books%work_forces - books%work_external)
    books%reactions = books%reactions + books%work_walls + books%work_pushed
    books%damping = books%damping - books%work_damping
    books%kinetic = kinetic
    books%momentum_scale = max(books%momentum_scale, sqrt(2.0_dp*max(kinetic, books%grid_after)*books%mass))
    books%largest = max(books%largest, kinetic, abs(books%internal), abs(books%loads), books%given, abs(books%reactions))
  end subroutine close_step

  !> The residual of the identity as a share of the largest energy exchanged
  pure real(dp) function energy_residual(books)
    type(books_t), intent(in) :: books
    energy_residual = abs(books%residual)/books%largest
  end function energy_residual

  !> Momentum that nobody gave, as a share of the largest sqrt(2 E_k M)
  pure real(dp) function momentum_residual(books, momentum)
    type(books_t), intent(in) :: books
    real(dp), intent(in) :: momentum(3) !! now [kg m/s]
    momentum_residual = sqrt(sum((momentum - books%momentum_start - books%impulse)**2))/books%momentum_scale
  end function momentum_residual

  !> Kinetic + stored + dissipated - external work [J]: constant in an exact solution
  pure real(dp) function total_energy(books)
    type(books_t), intent(in) :: books
    total_energy = books%kinetic + books%stored + books%plastic + books%damping + books%removed - books%loads - books%reactions
  end function total_energy

  !> Change of the total since the start, as a share of the largest energy exchanged
  pure real(dp) function energy_drift(books)
    type(books_t), intent(in) :: books
    energy_drift = (total_energy(books) - books%kinetic_start - books%stored_start)/books%largest
  end function energy_drift

  !> Whether a step gained energy that nobody gave. In a sound step kinetic plus stored plus dissipated energy less the work of
  !> loads and sides stays, but for the losses of the transfers and the half step between velocities and positions, which moves
  !> up to (omega dt)^2/2 of it. Half of what was there is no such thing.
  pure logical function energy_from_nothing(before, stored_before, now, stored, noise)
    type(books_t), intent(in) :: before, now !! at the start and at the end of the step
    real(dp), intent(in) :: stored_before, stored !! elastic energy then [J]
    real(dp), intent(in) :: noise !! round-off of the elastic energy [J]
    real(dp) :: gain, present
    gain = (total_energy(now) - now%stored + stored) - (total_energy(before) - before%stored + stored_before)
    present = before%kinetic + abs(stored_before) + abs(now%loads - before%loads) + abs(now%reactions - before%reactions)
    energy_from_nothing = .not. gain <= most_gain*max(present, small_energy*now%largest) + noise ! so that NaN is wrong
  end function energy_from_nothing

  !> Work of the internal forces that the material does not know of: the error of the stress-update scheme [J]
  pure real(dp) function stress_update_error(books)
    type(books_t), intent(in) :: books
    stress_update_error = -books%internal - (books%stored - books%stored_start) - books%plastic
  end function stress_update_error

end module gimp_books
