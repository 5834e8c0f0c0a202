!> Whole steps of small bodies: motions whose discrete solution is known in closed form
program test_stepper
  use gimp_kinds, only: wp
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp
  use gimp_domains, only: domain_stretch
  use gimp_engine, only: engine_t
  use gimp_error, only: error_t
  use gimp_run_state, only: stepper_t, usf, usl, musl, usavg, scheme_of_word
  use gimp_stepper, only: start_run, plan_step, take_step
  use gimp_step_size, only: rule_fixed, rule_adaptive
  use gimp_walls, only: side_periodic, side_symmetry, set_walls
  use gimp_engine_fixture, only: cloud_t, lattice_cloud, make_engine, read_cloud
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp
  integer :: scheme, basis

  call begin_suite("stepper")
  call test_words()
  do scheme = usf, usavg
    do basis = basis_linear, basis_cpgimp
      call test_translation(2, scheme, basis)
    end do
    call test_translation(1, scheme, basis_cpgimp)
    call test_translation(3, scheme, basis_ugimp)
    call test_free_fall(scheme)
    call test_seam(scheme)
    call test_mirror(scheme)
  end do
  call test_changing_steps()
  call test_sorting_leaves_no_trace()
  call test_errors()
  call end_suite()

contains

  subroutine test_words()
    call check(scheme_of_word("musl"), musl, "word of a scheme")
    call check(scheme_of_word("leapfrog"), 0, "an unknown scheme")
  end subroutine test_words

  !> A block of 3 cells an axis (2 for 3D) from the cell `low`, in a box of `cells`, at rest
  subroutine block(dim, low, cells, basis, scheme, dt, s, cloud)
    integer, intent(in) :: dim, low(3), cells(3), basis, scheme
    real(wp), intent(in) :: dt !! [s]
    type(stepper_t), intent(out) :: s
    type(cloud_t), intent(inout) :: cloud !! on entry: not allocated, or the particles to take
    if (.not. allocated(cloud%x)) call lattice_cloud(dim, low, merge([2, 2, 2], [3, 3, 3], dim == 3), 2, spacing, 1000.0_wp, cloud)
    call make_engine(dim, basis, cells, spacing, cloud, s%engine)
    if (basis == basis_cpgimp) s%engine%domain_rule = domain_stretch
    s%method%scheme = scheme
    s%time_options%rule = rule_fixed
    s%time_options%step = dt
    s%time_options%end = 1.0e9_wp
  end subroutine block

  subroutine run(s, steps, what)
    type(stepper_t), intent(inout) :: s
    integer, intent(in) :: steps
    character(len=*), intent(in) :: what
    type(error_t), allocatable :: error
    integer :: k
    if (s%step == 0) call start_run(s, error)
    do k = 1, steps
      if (.not. allocated(error)) call plan_step(s, 1.0e9_wp, error)
      if (.not. allocated(error)) call take_step(s, error)
    end do
    if (allocated(error)) print "(a)", error%message
    call check_true(.not. allocated(error), what//": the run goes through")
  end subroutine run

  !> A body without stress flies on: through 10 cells and two sorts at least, velocities stay, F = I, positions are X + v t.
  !> Velocities are averages of themselves: round-off of some 500 steps, no more than 1e-12.
  subroutine test_translation(dim, scheme, basis)
    integer, intent(in) :: dim, scheme, basis
    real(wp), parameter :: v(3) = [0.7_wp, -0.3_wp, 0.4_wp]
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    real(wp) :: way(3)
    integer :: k, steps
    character(len=:), allocatable :: which
    which = ", scheme "//text_of(scheme)//", basis "//text_of(basis)//", "//text_of(dim)//"D"
    call lattice_cloud(dim, [3, 9, 3], merge([2, 2, 2], [3, 3, 3], dim == 3), 2, spacing, 1000.0_wp, cloud)
    do k = 1, dim
      cloud%v(k, :) = v(k)
      cloud%x(k, :) = cloud%x(k, :) + 0.0131_wp*k ! nobody on a face
    end do
    call block(dim, [0, 0, 0], merge([22, 22, 22], [1, 1, 1], [1, 2, 3] <= dim), basis, scheme, 0.003_wp, s, cloud)
    steps = 480 ! 1.44 s: 10.1 cells along x
    call run(s, steps, "translation"//which)
    call read_cloud(s%engine, after)
    way = v*0.003_wp*steps/spacing
    call check_true(way(1) > 10.0_wp .and. s%books%sorts > merge(0, 2, dim == 1), "far enough to be sorted"//which)
    do k = 1, dim
      call check(maxval(abs(after%v(k, :) - v(k))), 0.0_wp, 1.0e-12_wp, "velocity"//which)
      call check(maxval(abs(after%x(k, :) - cloud%x(k, :) - way(k)))*spacing, 0.0_wp, 1.0e-12_wp, "position"//which)
    end do
    call check(maxval(abs(after%f - cloud%f)), 0.0_wp, 1.0e-11_wp, "no strain"//which)
    call check(int(s%particle_steps), steps*cloud%n, "particle-steps are counted"//which)
  end subroutine test_translation

  !> Constant gravity: leap-frog has v = g (n - 1/2) dt, x = g (n dt)^2/2 exactly with the half-step start; without it
  !> v = g n dt, x = g dt^2 n (n + 1)/2. FLIP and PIC alike, since every particle has the same velocity.
  subroutine test_free_fall(scheme)
    integer, intent(in) :: scheme
    real(wp), parameter :: dt = 0.004_wp, gravity(3) = [0.3_wp, -1.0_wp, 0.0_wp]
    integer, parameter :: n = 200
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    integer :: k, half, flip
    real(wp) :: v, x
    do half = 0, 1
      do flip = 0, 1
        if (allocated(cloud%x)) deallocate (cloud%x)
        call block(2, [4, 9, 0], [16, 16, 1], basis_cpgimp, scheme, dt, s, cloud)
        s%method%half_start = half == 1
        s%method%flip = flip
        allocate (s%loads%gravity(1), s%loads%load(0))
        s%loads%gravity(1)%acceleration = gravity
        call run(s, n, "free fall, scheme "//text_of(scheme))
        call read_cloud(s%engine, after)
        v = merge((n - 0.5_wp)*dt, n*dt, half == 1)
        x = merge(0.5_wp*(n*dt)**2, 0.5_wp*dt*dt*n*(n + 1.0_wp), half == 1)
        do k = 1, 2
          call check(maxval(abs(after%v(k, :) - gravity(k)*v)), 0.0_wp, 1.0e-12_wp, "falling velocity, scheme "//text_of(scheme))
          call check(maxval(abs(after%x(k, :) - cloud%x(k, :) - gravity(k)*x/spacing)), 0.0_wp, 1.0e-11_wp, &
                     "falling way, scheme "//text_of(scheme))
        end do
      end do
    end do
  end subroutine test_free_fall

  !> Steps that change from one to the next: positions are still g t^2/2, since each kick reaches from middle to middle
  subroutine test_changing_steps()
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    type(error_t), allocatable :: error
    integer :: k
    call block(2, [4, 9, 0], [16, 16, 1], basis_ugimp, usl, 0.0_wp, s, cloud)
    s%time_options%rule = rule_adaptive
    allocate (s%loads%gravity(1), s%loads%load(0))
    s%loads%gravity(1)%acceleration = [0.0_wp, -1.0_wp, 0.0_wp]
    call start_run(s, error)
    do k = 1, 150
      s%dt = 0.004_wp*(1.0_wp + 0.5_wp*sin(real(k, wp)))
      if (.not. allocated(error)) call take_step(s, error)
    end do
    call check_true(.not. allocated(error), "changing steps: the run goes through")
    call read_cloud(s%engine, after)
    call check(maxval(abs(after%x(2, :) - cloud%x(2, :) + 0.5_wp*s%time**2/spacing)), 0.0_wp, 1.0e-11_wp, &
               "leap-frog with changing steps is exact for constant gravity")
    call check(maxval(abs(after%v(2, :) + s%time - 0.5_wp*s%dt)), 0.0_wp, 1.0e-12_wp, "velocities are those of the last half step")
  end subroutine test_changing_steps

  !> A vibrating body that flies over the seam of a periodic box does the same as far from it
  subroutine test_seam(scheme)
    integer, intent(in) :: scheme
    type(stepper_t) :: at_seam, inside
    type(cloud_t) :: cloud, shifted, after, expected
    integer :: i
    call lattice_cloud(2, [3, 4, 0], [4, 4, 1], 2, spacing, 1000.0_wp, cloud)
    call shake(cloud)
    cloud%v(1, :) = cloud%v(1, :) + 0.5_wp
    shifted = cloud
    shifted%x(1, :) = modulo(cloud%x(1, :) + 6.0_wp, 13.0_wp)
    call block(2, [0, 0, 0], [13, 13, 1], basis_cpgimp, scheme, 0.004_wp, inside, cloud)
    call block(2, [0, 0, 0], [13, 13, 1], basis_cpgimp, scheme, 0.004_wp, at_seam, shifted)
    do i = 1, 2
      at_seam%walls%side(i, 1)%condition = side_periodic
    end do
    call set_walls(at_seam%walls, at_seam%engine%grid)
    call run(inside, 60, "inside the box")
    call run(at_seam, 60, "on the seam")
    call read_cloud(inside%engine, expected)
    call read_cloud(at_seam%engine, after)
    call check(maxval(abs(modulo(after%x(1, :) - expected%x(1, :) - 6.0_wp + 6.5_wp, 13.0_wp) - 6.5_wp)), 0.0_wp, 1.0e-11_wp, &
               "positions over the seam, scheme "//text_of(scheme))
    call check(maxval(abs(after%v - expected%v)), 0.0_wp, 1.0e-11_wp, "velocities over the seam, scheme "//text_of(scheme))
    call check(maxval(abs(after%f - expected%f)), 0.0_wp, 1.0e-11_wp, "strains over the seam, scheme "//text_of(scheme))
    call check(real(at_seam%books%loss_p2g, wp), real(inside%books%loss_p2g, wp), 1.0e-11_wp, &
               "images are booked once: loss to the grid, scheme "//text_of(scheme))
    call check(real(at_seam%books%internal, wp), real(inside%books%internal, wp), 1.0e-11_wp, &
               "images are booked once: work of forces, scheme "//text_of(scheme))
  end subroutine test_seam

  !> Deformation and velocities that set a body vibrating
  subroutine shake(cloud)
    type(cloud_t), intent(inout) :: cloud
    integer :: i
    do i = 1, cloud%n
      cloud%f(:, i) = [1.04_wp, 0.02_wp, 0.0_wp, -0.01_wp, 0.97_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
      cloud%v(1, i) = 0.05_wp*sin(3.0_wp*cloud%x(2, i))
      cloud%v(2, i) = 0.05_wp*cos(2.0_wp*cloud%x(1, i))
    end do
  end subroutine shake

  !> Half a symmetric body on a plane of symmetry does what the whole body does
  subroutine test_mirror(scheme)
    integer, intent(in) :: scheme
    type(stepper_t) :: half, whole
    type(cloud_t) :: cloud, both, after, expected
    integer :: n
    call lattice_cloud(2, [0, 4, 0], [3, 4, 1], 2, spacing, 1000.0_wp, cloud)
    call shake(cloud)
    cloud%f([2, 4], :) = 0.0_wp
    cloud%v(1, :) = 0.05_wp*sin(cloud%x(1, :))
    n = cloud%n
    call lattice_cloud(2, [0, 4, 0], [6, 4, 1], 2, spacing, 1000.0_wp, both)
    both%x(:, :n) = cloud%x
    both%x(:, n + 1:) = cloud%x
    both%x(1, :n) = 8.0_wp + cloud%x(1, :)
    both%x(1, n + 1:) = 8.0_wp - cloud%x(1, :)
    both%v(:, :n) = cloud%v
    both%v(:, n + 1:) = cloud%v
    both%v(1, n + 1:) = -cloud%v(1, :)
    both%f(:, :n) = cloud%f
    both%f(:, n + 1:) = cloud%f
    call block(2, [0, 0, 0], [13, 13, 1], basis_cpgimp, scheme, 0.004_wp, half, cloud)
    half%walls%side(1, 1)%condition = side_symmetry
    call set_walls(half%walls, half%engine%grid)
    call block(2, [0, 0, 0], [16, 13, 1], basis_cpgimp, scheme, 0.004_wp, whole, both)
    call run(half, 60, "half a body")
    call run(whole, 60, "a whole body")
    call read_cloud(half%engine, after)
    call read_cloud(whole%engine, expected)
    call check(maxval(abs(after%x(1, :) + 8.0_wp - expected%x(1, :n))), 0.0_wp, 1.0e-11_wp, &
               "half does as the whole: positions, scheme "//text_of(scheme))
    call check(maxval(abs(after%v - expected%v(:, :n))), 0.0_wp, 1.0e-11_wp, "half does as the whole: velocities, scheme " &
               //text_of(scheme))
    call check(real(half%books%internal, wp), 0.5_wp*real(whole%books%internal, wp), &
               1.0e-10_wp*abs(real(whole%books%internal, wp)), "half the work, scheme "//text_of(scheme))
  end subroutine test_mirror

  !> How often particles are sorted must not matter but for the order of sums: round-off of 80 steps
  subroutine test_sorting_leaves_no_trace()
    type(stepper_t) :: s, often
    type(cloud_t) :: cloud, after, expected
    call lattice_cloud(2, [3, 4, 0], [4, 4, 1], 2, spacing, 1000.0_wp, cloud)
    call shake(cloud)
    cloud%v(1, :) = cloud%v(1, :) + 1.0_wp
    call block(2, [0, 0, 0], [16, 13, 1], basis_cpgimp, musl, 0.004_wp, s, cloud)
    call block(2, [0, 0, 0], [16, 13, 1], basis_cpgimp, musl, 0.004_wp, often, cloud)
    often%method%sort_every = 1
    call run(s, 80, "sorted when needed")
    call run(often, 80, "sorted in every step")
    call check(int(often%books%sorts), 81, "a sort in every step and one at the start")
    call check_true(s%books%sorts < 10, "and few when needed")
    call read_cloud(s%engine, expected)
    call read_cloud(often%engine, after)
    call check(maxval(abs(after%x - expected%x)), 0.0_wp, 1.0e-12_wp, "positions do not depend on sorting")
    call check(maxval(abs(after%v - expected%v)), 0.0_wp, 1.0e-12_wp, "nor velocities")
  end subroutine test_sorting_leaves_no_trace

  !> A particle that leaves, or turns inside out, ends the run with a message that names it, the step and the place
  subroutine test_errors()
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    type(error_t), allocatable :: error
    integer :: k
    call lattice_cloud(2, [1, 4, 0], [1, 1, 1], 1, spacing, 1000.0_wp, cloud)
    cloud%v(1, :) = -5.0_wp
    call block(2, [0, 0, 0], [13, 13, 1], basis_ugimp, musl, 0.004_wp, s, cloud)
    call start_run(s, error)
    do k = 1, 20
      if (allocated(error)) exit
      call plan_step(s, 1.0e9_wp, error)
      if (.not. allocated(error)) call take_step(s, error)
    end do
    call check_true(allocated(error), "a particle that leaves the box ends the run")
    if (allocated(error)) then
      call check_true(index(error%message, "step 8") > 0 .and. index(error%message, "particle 1 ") > 0 &
                      .and. index(error%message, "left the grid") > 0, "with step, particle and reason: "//error%message)
    end if
    call take_smallest(error)
    call check_true(allocated(error), "a step below the smallest ends the run")
    if (allocated(error)) call check_true(index(error%message, "collapsed") > 0, "and says so: "//error%message)
  end subroutine test_errors

  subroutine take_smallest(error)
    type(error_t), allocatable, intent(out) :: error
    type(stepper_t) :: s
    type(cloud_t) :: cloud
    call block(2, [4, 4, 0], [13, 13, 1], basis_ugimp, musl, 0.004_wp, s, cloud)
    s%time_options%rule = rule_adaptive
    s%time_options%smallest = 1.0_wp
    call start_run(s, error)
    if (.not. allocated(error)) call plan_step(s, 1.0e9_wp, error)
  end subroutine take_smallest

end program test_stepper
