!> XPIC and FMPM: steps against powers of dense matrices, the limit of the series, and what is never lost
program test_series
  use gimp_kinds, only: wp
  use gimp_basis, only: basis_linear, basis_ugimp, basis_cpgimp, weight_list_t, make_weight_list
  use gimp_domains, only: domain_stretch
  use gimp_splines, only: spline_t, make_spline
  use gimp_error, only: error_t
  use gimp_run_state, only: stepper_t, usl, musl, series_xpic, series_fmpm, position_grid, &
    momentum_of
  use gimp_stepper, only: start_run, take_step
  use gimp_step_size, only: rule_fixed
  use gimp_walls, only: side_stick, side_velocity, set_walls
  use gimp_books, only: energy_residual, momentum_residual
  use gimp_engine_fixture, only: cloud_t, random_cloud, lattice_cloud, make_engine, read_cloud, random_reals
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: spacing = 0.1_wp, dt = 0.002_wp
  integer, parameter :: cells(3) = [14, 12, 1]
  integer :: seed = 11, scheme, series, basis, order

  call begin_suite("series")
  do scheme = usl, musl
    do series = series_xpic, series_fmpm
      do basis = basis_linear, basis_cpgimp
        do order = 1, 4
          call test_matrix_powers(scheme, series, basis, order, walled=.false., list=order == 3)
        end do
        call test_matrix_powers(scheme, series, basis, 3, walled=.true., list=.false.)
      end do
    end do
  end do
  call test_noise()
  call end_suite()

contains

  !> A stepper with particles at rest strain: the first step has no forces, so that v+ = v
  subroutine unstrained(scheme, series, basis, order, cloud, s)
    integer, intent(in) :: scheme, series, basis, order
    type(cloud_t), intent(inout) :: cloud
    type(stepper_t), intent(out) :: s
    integer :: i
    cloud%f = spread([1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp], 2, cloud%n)
    call make_engine(2, basis, cells, spacing, cloud, s%engine)
    if (basis == basis_cpgimp) s%engine%domain_rule = domain_stretch
    s%method%scheme = scheme
    s%method%series = series
    s%method%order = order
    s%method%position = position_grid
    s%time_options%rule = rule_fixed
    s%time_options%step = dt
    s%dt = dt
    do i = 1, 2
      s%walls%side(i, :2)%condition = 0
    end do
  end subroutine unstrained

  !> v' = S sum over j < k of (I - S+ S)^j S+ v. Round-off of sums of a few dozen terms of order 1
  subroutine test_matrix_powers(scheme, series, basis, order, walled, list)
    integer, intent(in) :: scheme, series, basis, order
    logical, intent(in) :: walled !! sides hold nodes: at rest below, moving on the left
    logical, intent(in) :: list !! by the list kernel
    real(wp), parameter :: given(2) = [0.4_wp, -0.2_wp]
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    type(error_t), allocatable :: error
    real(wp), allocatable :: weight(:, :), expected(:, :), mass(:)
    real(wp) :: low(3), high(3)
    logical, allocatable :: held(:)
    character(len=:), allocatable :: which
    integer :: i
    which = ", series "//text_of(series)//", scheme "//text_of(scheme)//", basis "//text_of(basis)//", order "//text_of(order)
    if (walled) which = which//", walls"
    low = [merge(0.3_wp, 3.2_wp, walled), merge(0.3_wp, 3.2_wp, walled), 0.0_wp]
    high = [8.0_wp, 6.0_wp, 0.0_wp]
    call random_cloud(2, 60, low, high, 0.2_wp, 0.4_wp, seed, cloud)
    call unstrained(scheme, series, basis, order, cloud, s)
    s%engine%list_kernel = list
    if (walled) then
      s%walls%side(1, 2)%condition = side_stick
      s%walls%side(1, 1)%condition = side_velocity
      s%walls%side(1, 1)%velocity(:2) = given
      call set_walls(s%walls, s%engine%grid)
    end if
    call start_run(s, error)
    if (.not. allocated(error)) call take_step(s, error)
    call check_true(.not. allocated(error), "a step"//which)
    if (allocated(error)) return
    call read_cloud(s%engine, after)
    call dense_weights(cloud, basis, walled, weight, held)
    allocate (expected(2, cloud%n))
    mass = matmul(cloud%mass, weight)
    do i = 1, 2
      expected(i, :) = series_of(weight, cloud%mass, mass, held, merge(given(i), 0.0_wp, walled), cloud%v(i, :), order)
    end do
    call check(maxval(abs(after%v(:2, :) - expected)), 0.0_wp, 2.0e-13_wp, "velocities"//which)
    call check(energy_residual(s%books), 0.0_wp, 1.0e-14_wp, "energy"//which)
    call check(momentum_residual(s%books, momentum_of(s)), 0.0_wp, 1.0e-14_wp, "momentum"//which)
  end subroutine test_matrix_powers

  !> Weights of particles (rows) at the nodes of the box and one layer beyond, and which nodes the sides hold
  subroutine dense_weights(cloud, basis, walled, weight, held)
    type(cloud_t), intent(in) :: cloud
    integer, intent(in) :: basis
    logical, intent(in) :: walled
    real(wp), allocatable, intent(out) :: weight(:, :)
    logical, allocatable, intent(out) :: held(:)
    type(weight_list_t) :: list
    type(spline_t) :: spline
    real(wp) :: half(3)
    integer :: p, k, i, j, width
    width = cells(1) + 3
    allocate (weight(cloud%n, width*(cells(2) + 3)), source=0.0_wp)
    do p = 1, cloud%n
      half = cloud%half(:, p)
      if (basis == basis_linear) half = 0.0_wp
      call make_weight_list(2, cloud%x(:, p), half, spline, list)
      do k = 1, list%n
        j = 1 + (list%node(1, k) + 1) + width*(list%node(2, k) + 1)
        weight(p, j) = weight(p, j) + list%s(k)
      end do
    end do
    allocate (held(size(weight, 2)))
    do i = 1, size(held)
      held(i) = walled .and. (modulo(i - 1, width) <= 1 .or. (i - 1)/width <= 1)
    end do
  end subroutine dense_weights

  !> The same by dense matrices, for one component
  function series_of(weight, m, mass, held, given, v, order) result(new)
    real(wp), intent(in) :: weight(:, :), m(:), mass(:), given, v(:)
    logical, intent(in) :: held(:)
    integer, intent(in) :: order
    real(wp) :: new(size(v)), term(size(mass)), total(size(mass))
    integer :: j, i, width
    width = cells(1) + 3
    term = 0.0_wp
    where (mass > 0.0_wp) term = matmul(m*v, weight)/mass
    do i = 1, size(held)
      if (.not. held(i)) cycle
      term(i) = 0.0_wp
      if ((i - 1)/width > 1) term(i) = given ! the moving side is on the left; where the two meet the one below holds
    end do
    total = term
    do j = 2, order
      where (mass > 0.0_wp) term = term - matmul(m*matmul(weight, term), weight)/mass
      where (held) term = 0.0_wp
      total = total + term
    end do
    new = matmul(weight, total)
  end function series_of

  !> Random velocities of particles are mostly noise that no grid velocity shows. The share of the kinetic energy that one step
  !> keeps rises with the order to that of the projection on what the grid can show, which loses nothing but the noise
  subroutine test_noise()
    integer, parameter :: orders(5) = [1, 2, 3, 5, 8]
    type(stepper_t) :: s
    type(cloud_t) :: cloud, after
    type(error_t), allocatable :: error
    real(wp), allocatable :: weight(:, :), power(:, :), total(:, :), node_mass(:), smoother(:, :), u(:)
    real(wp) :: kept(5), most
    logical, allocatable :: held(:)
    integer :: i, j
    call lattice_cloud(2, [3, 3, 0], [6, 6, 1], 2, spacing, 1000.0_wp, cloud)
    do i = 1, cloud%n
      call random_reals(seed, cloud%v(:2, i))
    end do
    do i = 1, 5
      call unstrained(usl, series_fmpm, basis_ugimp, orders(i), cloud, s)
      call start_run(s, error)
      if (.not. allocated(error)) call take_step(s, error)
      call check_true(.not. allocated(error), "noise: a step")
      call read_cloud(s%engine, after)
      kept(i) = sum(after%v**2)/sum(cloud%v**2)
      do j = 1, 2
        call check(sum(after%mass*after%v(j, :)), sum(cloud%mass*cloud%v(j, :)), 1.0e-13_wp*sum(cloud%mass), &
                   "momentum of the transfer, order "//text_of(orders(i)))
      end do
    end do
    ! the limit: sum over j < 2^20 of (I - S S+)^j S S+, doubled term by term
    call dense_weights(cloud, basis_ugimp, .false., weight, held)
    node_mass = matmul(cloud%mass, weight)
    smoother = weight
    do i = 1, size(node_mass)
      smoother(:, i) = smoother(:, i)/max(node_mass(i), tiny(1.0_wp))*cloud%mass
    end do
    smoother = matmul(weight, transpose(smoother)) ! S S+
    allocate (power(cloud%n, cloud%n), source=-smoother)
    do i = 1, cloud%n
      power(i, i) = power(i, i) + 1.0_wp
    end do
    total = smoother
    do i = 1, 20
      total = total + matmul(power, total)
      power = matmul(power, power)
    end do
    most = 0.0_wp
    do j = 1, 2
      u = matmul(total, cloud%v(j, :))
      most = most + sum(u**2)
    end do
    most = most/sum(cloud%v**2)
    ! here .07, .13, .17, .22, .27 of it, and .33 in the limit
    call check_true(all(kept(2:) > kept(:4)) .and. kept(1) < 0.3_wp*most .and. kept(5) > 0.75_wp*most .and. kept(5) < most, &
                    "energy kept rises towards the limit")
  end subroutine test_noise

end program test_series
