!> Whole steps on meshes whose sides lie across the axes: the books close, and a body turned with its mesh moves as it does on the grid
program test_mesh_steps
  use gimp_kinds, only: wp, dp
  use gimp_common_kinds, only: pi
  use gimp_basis, only: basis_linear
  use gimp_error, only: error_t
  use gimp_text, only: text_of
  use gimp_mesh, only: mesh_t
  use gimp_made_meshes, only: made_quads, made_hybrid, turn_mesh
  use gimp_engine, only: leaving_held
  use gimp_books, only: energy_residual, momentum_residual
  use gimp_walls, only: wall_t, side_slip, side_velocity, side_free
  use gimp_mesh_walls, only: set_mesh_walls
  use gimp_loads, only: set_side_loads
  use gimp_run_state, only: stepper_t, usf, usl, usavg, generalized_alpha, newmark, series_fmpm, damping_local, momentum_of
  use gimp_step_size, only: rule_fixed
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine, read_cloud
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp
  integer :: scheme

  call begin_suite("steps on meshes")
  do scheme = -newmark, usavg
    if (scheme < usf .and. scheme > -generalized_alpha) cycle
    call test_books(scheme, 1)
    call test_turned(scheme)
  end do
  call test_books(usl, 3) ! FMPM of order 3: sides hold its terms
  call end_suite()

contains

  !> A body in the lower left of a mesh of 6 x 6 cells that is turned: floor and left side slip, the right side pushes, a pressure
  !> acts on what of the body reaches the top, gravity pulls across
  subroutine make_run(scheme, order, degrees, mesh, s)
    integer, intent(in) :: scheme, order
    real(dp), intent(in) :: degrees
    type(mesh_t), intent(in) :: mesh !! not yet turned
    type(stepper_t), intent(out) :: s
    type(mesh_t) :: turned
    type(cloud_t) :: cloud
    type(wall_t) :: condition(4)
    type(error_t), allocatable :: error
    real(wp) :: turn(3, 3)
    integer :: i
    call lattice_cloud(2, [0, 0, 0], [6, 6, 1], 2, spacing, 1000.0_wp, cloud)
    turn = turn_of(degrees)
    do i = 1, cloud%n
      cloud%v(:2, i) = [0.2_wp*sin(cloud%x(2, i)), -0.1_wp*cos(cloud%x(1, i))]
      cloud%v(:, i) = matmul(turn, cloud%v(:, i))
      cloud%x(:, i) = matmul(turn, cloud%x(:, i))
    end do
    turned = mesh
    call turn_mesh(turned, degrees)
    call make_engine(2, basis_linear, [6, 6, 1], spacing, cloud, s%engine, acceleration=scheme < 0, mesh=turned)
    s%engine%leaving = leaving_held
    condition%condition = [side_slip, side_velocity, side_slip, side_free]
    condition(2)%velocity = matmul(turn, [-0.4_dp, 0.1_dp, 0.0_dp])
    condition(2)%table%times = [0.0_dp, 0.05_dp]
    condition(2)%table%factors = [0.5_dp, 1.0_dp]
    call set_mesh_walls(s%walls, s%engine%mesh, condition, error)
    call check_true(.not. allocated(error), "conditions are taken")
    allocate (s%loads%gravity(1), s%loads%side(1))
    s%loads%gravity(1)%acceleration = matmul(turn, [3.0_dp, -5.0_dp, 0.0_dp])
    s%loads%side(1)%group = 4
    s%loads%side(1)%pressure = 40.0_dp
    s%loads%side(1)%vector = matmul(turn, [15.0_dp, 0.0_dp, 0.0_dp])
    call set_side_loads(s%loads, s%engine%mesh, spacing)
    s%method%scheme = merge(usl, scheme, scheme < 0)
    if (scheme < 0) s%method%integrator = -scheme
    if (order > 1) s%method%series = series_fmpm
    s%method%order = order
    s%method%cutoff = 0.0_wp
    s%time_options%rule = rule_fixed
    s%time_options%step = 0.004_wp
  end subroutine make_run

  pure function turn_of(degrees) result(turn)
    real(dp), intent(in) :: degrees
    real(wp) :: turn(3, 3), a
    a = real(degrees*pi/180, wp)
    turn = reshape([cos(a), sin(a), 0.0_wp, -sin(a), cos(a), 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], [3, 3])
  end function turn_of

  subroutine run(s, steps, what)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: steps
    character(len=*), intent(in) :: what
    type(error_t), allocatable :: error
    integer :: k
    call start_run(s, error)
    do k = 1, steps
      if (.not. allocated(error)) call plan_step(s, 1.0e9_wp, error)
      if (.not. allocated(error)) call take_step(s, error)
    end do
    if (allocated(error)) print "(a)", error%message
    call check_true(.not. allocated(error), what//": the run goes through")
  end subroutine run

  !> Residuals as in test_books, with local damping; the sides carry and push, the pressure and gravity work
  subroutine test_books(scheme, order)
    integer, intent(in) :: scheme, order
    type(stepper_t) :: s
    character(len=:), allocatable :: which
    which = "scheme "//text_of(scheme)//", order "//text_of(order)
    call make_run(scheme, order, 30.0_dp, made_hybrid([6, 6], 0.2_dp), s)
    s%method%damping = damping_local
    s%method%damping_factor = 0.2_wp
    call run(s, 60, which)
    call check(energy_residual(s%books), 0.0_dp, 1.0e-12_dp, which//": energy residual")
    call check(momentum_residual(s%books, momentum_of(s)), 0.0_dp, 1.0e-13_dp, which//": momentum residual")
    call check_true(s%books%largest > 0.1_dp .and. abs(s%books%reactions) > 0.01_dp, which//": there was energy, and sides did work")
    call check_true(abs(s%books%loads) > 0.01_dp, which//": loads did work")
  end subroutine test_books

  !> A mesh of squares, turned with all that acts on it: turned back the body is where it is on the mesh that was not turned. Round-off of 40
  !> steps
  subroutine test_turned(scheme)
    integer, intent(in) :: scheme
    type(stepper_t) :: s
    type(cloud_t) :: straight, turned
    character(len=:), allocatable :: which
    real(wp) :: back(3, 3)
    which = "turned body, scheme "//text_of(scheme)
    call make_run(scheme, 1, 0.0_dp, made_quads([6, 6]), s)
    call run(s, 40, which)
    call read_cloud(s%engine, straight)
    call make_run(scheme, 1, 30.0_dp, made_quads([6, 6]), s)
    call run(s, 40, which)
    call read_cloud(s%engine, turned)
    back = turn_of(-30.0_dp)
    call check(maxval(abs(matmul(back, turned%x) - straight%x)), 0.0_wp, 1.0e-10_wp, which//": positions")
    call check(maxval(abs(matmul(back, turned%v) - straight%v)), 0.0_wp, 1.0e-10_wp, which//": velocities")
  end subroutine test_turned

end program test_mesh_steps
