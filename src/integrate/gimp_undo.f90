!> Steps that may be undone: the state at the start of each is kept, and brought back when the step goes wrong
module gimp_undo
  use gimp_kinds, only: dp
  use gimp_error, only: error_t
  use gimp_timer, only: seconds_now
  use gimp_books, only: energy_from_nothing
  use gimp_chunk_state, only: elastic_energy_of
  use gimp_saved_state, only: clock_t, save_particles, recall_particles
  use gimp_run_state, only: stepper_t, find_held, phase_checks
  use gimp_particle_stage, only: run_pass, state_pass
  implicit none(type, external)
  private
  public :: save_state, recall_state, went_wrong


contains

  !> Keep the state at the start of a step
  subroutine save_state(s)
    type(stepper_t), intent(inout) :: s
    real(dp) :: start
    start = seconds_now()
    call save_particles(s%engine%particles, s%engine%border%cut, s%books%sorts /= s%saved%books%sorts, s%saved)
    s%saved%books = s%books
    s%saved%clock = clock_t(time=s%time, step=s%step, particle_steps=s%particle_steps, dt=s%dt, free_dt=s%free_dt, &
                            kick_before=s%kick_before, rate=s%rate, speed=s%speed, strain_rate=s%strain_rate, &
                            sort_now=s%sort_now, kinetic_peak=s%kinetic_peak, stored=s%stored, &
                            power=s%power, pull=s%pull)
    s%seconds(phase_checks) = s%seconds(phase_checks) + seconds_now() - start
  end subroutine save_state

  !> Back to the start of the step: particles and blocks, then pads as they were, then clock and books
  subroutine recall_state(s, error)
    type(stepper_t), intent(inout) :: s
    type(error_t), allocatable, intent(out) :: error
    logical :: sorted
    sorted = s%books%sorts /= s%saved%books%sorts
    call recall_particles(s%saved, sorted, s%engine)
    if (sorted) call find_held(s)
    associate (clock => s%saved%clock)
      call run_pass(s, state_pass(s, clock%time), error)
      s%time = clock%time
      s%step = clock%step
      s%particle_steps = clock%particle_steps
      s%kick_before = clock%kick_before
      s%rate = clock%rate
      s%speed = clock%speed
      s%strain_rate = clock%strain_rate
      s%sort_now = clock%sort_now
      s%kinetic_peak = clock%kinetic_peak
      s%stored = clock%stored
      s%power = clock%power
      s%pull = clock%pull
    end associate
    s%books = s%saved%books ! the pass has booked what it counts once more
  end subroutine recall_state

  !> Whether the step just taken is to be redone: a particle failed, or energy came out of nothing
  logical function went_wrong(s, failed)
    type(stepper_t), intent(inout) :: s
    logical, intent(in) :: failed
    real(dp) :: start
    went_wrong = failed .and. .not. s%hopeless
    if (failed) return
    start = seconds_now()
    s%stored = elastic_energy_of(s%engine)
    went_wrong = energy_from_nothing(s%saved%books, s%saved%clock%stored, s%books, s%stored, s%energy_noise)
    s%seconds(phase_checks) = s%seconds(phase_checks) + seconds_now() - start
  end function went_wrong

end module gimp_undo
