!> The size of the next step, and which limit set it
module gimp_step_size
  use gimp_kinds, only: dp
  use gimp_stability, only: check_none
  implicit none(type, external)
  private
  public :: time_options_t, next_step, limit_word, rule_adaptive, rule_uniform, rule_fixed
  public :: limit_prescribed, limit_courant, limit_displacement, limit_strain, limit_growth, limit_output, limit_stability, &
    limit_redone, n_limits, most_halvings

  integer, parameter :: rule_adaptive = 1, rule_uniform = 2, rule_fixed = 3
  integer, parameter :: limit_prescribed = 1, limit_courant = 2, limit_displacement = 3, limit_strain = 4, limit_growth = 5, &
    limit_output = 6, limit_stability = 7, limit_redone = 8, n_limits = 8
  character(len=12), parameter :: words(n_limits) = [character(len=12) :: "prescribed", "courant", "displacement", "strain", &
                                                     "growth", "output", "stability", "redone"]
  integer, parameter :: most_halvings = 6 !! of a step that goes wrong
  real(dp), parameter :: most_displacement = 0.5_dp !! cells in a step (Berzins 2018)
  real(dp), parameter :: most_strain = 0.1_dp !! dt |L|

  !> How time is divided
  type :: time_options_t
    real(dp) :: end = 0.0_dp !! [s]
    integer :: rule = rule_adaptive
    real(dp) :: courant = 0.4_dp
    real(dp) :: reach = 1.0_dp !! step of Courant number 1 as a share of h/(c + |v|): the integrator's own limit
    real(dp) :: step = 0.0_dp !! prescribed step [s]
    real(dp) :: growth = 1.05_dp !! largest ratio of a step to the one before
    real(dp) :: smallest = 0.0_dp !! below: the run has failed [s]
    integer :: max_steps = 0 !! 0: no limit
    integer :: check = check_none !! how the critical step is found
    integer :: check_every = 100 !! steps
    real(dp) :: most_of_critical = 0.0_dp !! share of the critical step that a step may take; 0: it is reported only
    logical :: redo = .false. !! a step that goes wrong is undone and taken again at half the length
  end type time_options_t

contains

  !> Name of a limit, as the history and the log give it
  pure function limit_word(limit) result(word)
    integer, intent(in) :: limit
    character(len=:), allocatable :: word
    word = trim(words(limit))
  end function limit_word

  !> The next step. An adaptive step obeys dt <= C h/(c + |v|), half a cell of displacement, a strain of 0.1 and the growth
  !> limit, and on request a share of the critical step; it is shortened (never lengthened) to meet the next time of interest, evenly over the last three steps.
  pure subroutine next_step(options, spacing, rate, speed, strain_rate, critical, last, until, dt, free, limit)
    type(time_options_t), intent(in) :: options
    real(dp), intent(in) :: spacing !! [m]
    real(dp), intent(in) :: rate !! largest wave speed plus particle speed [m/s]
    real(dp), intent(in) :: speed !! largest particle speed [m/s]
    real(dp), intent(in) :: strain_rate !! largest norm of the velocity gradient [1/s]
    real(dp), intent(in) :: critical !! critical step when last checked; huge if it never was [s]
    real(dp), intent(in) :: last !! unshortened step before; 0 at the start [s]
    real(dp), intent(in) :: until !! time left to the next time of interest [s]
    real(dp), intent(out) :: dt !! [s]
    real(dp), intent(out) :: free !! the step before it was shortened [s]
    integer, intent(out) :: limit
    integer :: n
    if (options%rule /= rule_adaptive) then
      dt = options%step
      free = dt
      limit = limit_prescribed
      return
    end if
    dt = options%courant*options%reach*spacing/max(rate, tiny(1.0_dp))
    limit = limit_courant
    if (speed*dt > most_displacement*spacing) then
      dt = most_displacement*spacing/speed
      limit = limit_displacement
    end if
    if (strain_rate*dt > most_strain) then
      dt = most_strain/strain_rate
      limit = limit_strain
    end if
    if (options%most_of_critical > 0.0_dp .and. dt/critical > options%most_of_critical) then
      dt = options%most_of_critical*critical
      limit = limit_stability
    end if
    if (last > 0.0_dp .and. dt > options%growth*last) then
      dt = options%growth*last
      limit = limit_growth
    end if
    free = dt
    if (until < 3.0_dp*dt) then
      n = max(1, ceiling(until/dt - 1.0e-9_dp))
      if (until/n < dt*(1.0_dp - 1.0e-9_dp)) limit = limit_output
      dt = until/n
    end if
  end subroutine next_step

end module gimp_step_size
