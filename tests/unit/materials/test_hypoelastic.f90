!> Rate laws: simple shear against closed forms with the order in time, pure spin, objectivity, books of the energy
program test_hypoelastic
  use gimp_kinds, only: wp, lanes, pi
  use gimp_error, only: error_t
  use gimp_tensor, only: identity, multiply, push_forward, increment_cayley, increment_forward, rotation_cayley
  use gimp_material, only: material_t
  use gimp_material_table, only: make_material, material_options_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer, parameter :: states = 7

  call begin_suite("hypoelastic")
  call test_one_step()
  call test_simple_shear("hughes_winget", "symmetric", 3.7e-4_wp, 9.2e-5_wp)
  call test_simple_shear("hughes_winget", "plain", 8.5e-3_wp, 4.2e-3_wp)
  call test_simple_shear("jaumann", "", 1.9e-1_wp, 9.0e-2_wp)
  call test_hundred_turns()
  call test_pure_spin()
  call test_objectivity()
  call test_stretch()
  call test_energy()
  call test_starting_stress()
  call end_suite()

contains

  !> E = 1000, nu = 0.3, rho = 1000
  subroutine make(rate, form, material)
    character(len=*), intent(in) :: rate, form
    class(material_t), allocatable, intent(out) :: material
    type(material_options_t) :: options
    type(error_t), allocatable :: error
    options%name = "sample"
    options%model = "linear_elastic"
    options%density = 1000
    options%young_modulus = 1000
    options%poisson_ratio = 0.3_wp
    options%rate = rate
    options%rate_form = form
    call make_material(options, material, error)
    if (allocated(error)) error stop "the sample material is sound"
  end subroutine make

  pure real(wp) function noise(i, seed)
    integer, intent(in) :: i, seed
    noise = sin(real(12*i*i + 71*i + 397*seed, wp))
  end function noise

  subroutine random_state(seed, l, stress)
    integer, intent(in) :: seed
    real(wp), intent(out) :: l(lanes, 9), stress(lanes, 6)
    integer :: c, k
    do k = 1, lanes
      l(k, :) = [(noise(9*k + c, seed), c=1, 9)]
      stress(k, :) = [(100*noise(6*k + c, seed + 9), c=1, 6)]
    end do
  end subroutine random_state

  pure function full(a) result(matrix)
    real(wp), intent(in) :: a(9)
    real(wp) :: matrix(3, 3)
    matrix = transpose(reshape(a, [3, 3]))
  end function full

  pure function full_symmetric(s) result(matrix)
    real(wp), intent(in) :: s(6)
    real(wp) :: matrix(3, 3)
    matrix = reshape([s(1), s(4), s(6), s(4), s(2), s(5), s(6), s(5), s(3)], [3, 3])
  end function full_symmetric

  !> One step against the formulas written with 3x3 arrays
  subroutine test_one_step()
    class(material_t), allocatable :: material
    real(wp), parameter :: dt = 0.2_wp
    real(wp) :: l(lanes, 9), stress(lanes, 6), df(lanes, 9), q(lanes, 9), unit(lanes, 9), state(lanes, states), work(lanes)
    real(wp) :: tau(lanes, 6), speed2(lanes)
    real(wp), dimension(3, 3) :: d, w, s, a, turn, expected, eye
    integer :: k, scheme
    eye = reshape(identity, [3, 3])
    unit = spread(identity, 1, lanes)
    do scheme = 1, 3
      if (scheme == 1) call make("", "symmetric", material)
      if (scheme == 2) call make("hughes_winget", "plain", material)
      if (scheme == 3) call make("jaumann", "", material)
      call random_state(scheme, l, stress)
      call material%start_state(unit, stress, state)
      call increment_forward(dt, l, df)
      call material%advance_state(dt, l, df, df, state, work)
      call material%kirchhoff(df, state, tau, speed2)
      call rotation_cayley(dt, l, q)
      do k = 1, lanes
        d = (full(l(k, :)) + transpose(full(l(k, :))))/2
        w = (full(l(k, :)) - transpose(full(l(k, :))))/2
        s = full_symmetric(stress(k, :))
        a = dt*(material%lambda*(d(1, 1) + d(2, 2) + d(3, 3))*eye + 2*material%mu*d)/2
        turn = full(q(k, :))
        if (scheme == 1) expected = matmul(turn, matmul(s + a, transpose(turn))) + a
        if (scheme == 2) expected = matmul(turn, matmul(s, transpose(turn))) + 2*a
        if (scheme == 3) expected = s + dt*(matmul(w, s) - matmul(s, w)) + 2*a
        call check(reshape(full_symmetric(state(k, 2:7)), [9]), reshape(expected, [9]), 1.0e-12_wp, "one step")
        a = full(df(k, :))
        call check(tau(k, :), state(k, 2:7)*(a(1, 1)*(a(2, 2)*a(3, 3) - a(2, 3)*a(3, 2)) &
          - a(1, 2)*(a(2, 1)*a(3, 3) - a(2, 3)*a(3, 1)) + a(1, 3)*(a(2, 1)*a(3, 2) - a(2, 2)*a(3, 1))), 1.0e-12_wp, &
          "tau = J sigma")
      end do
      call check(work, spread(0.0_wp, 1, lanes), 0.0_wp, "elastic: nothing dissipated")
    end do
  end subroutine test_one_step

  !> Shear to g = 6: sigma_12 = G sin g, sigma_11 = -sigma_22 = G (1 - cos g); the error with 100 and 200 steps is known
  subroutine test_simple_shear(rate, form, coarse, fine)
    character(len=*), intent(in) :: rate, form
    real(wp), intent(in) :: coarse, fine !! largest error of a component at G = 1, two digits
    real(wp) :: with_100, with_200
    call largest_error(rate, form, 100, with_100)
    call largest_error(rate, form, 200, with_200)
    call check(with_100/coarse, 1.0_wp, 0.03_wp, rate//" "//form//": error with 100 steps") ! two digits are given
    call check(with_200/fine, 1.0_wp, 0.03_wp, rate//" "//form//": error with 200 steps")
    call check(log(with_100/with_200)/log(2.0_wp), merge(2.0_wp, 1.0_wp, form == "symmetric"), 0.1_wp, &
      rate//" "//form//": order in time")
  end subroutine test_simple_shear

  !> Largest error of a component at the end, at G = 1
  subroutine largest_error(rate, form, steps, error)
    character(len=*), intent(in) :: rate, form
    integer, intent(in) :: steps
    real(wp), intent(out) :: error
    class(material_t), allocatable :: material
    real(wp) :: l(lanes, 9), f(lanes, 9), df(lanes, 9), stress(lanes, 6), state(lanes, states), work(lanes), g, dt
    integer :: n
    call make(rate, form, material)
    l = 0
    l(:, 2) = 1
    stress = 0
    f = spread(identity, 1, lanes)
    call material%start_state(f, stress, state)
    dt = 6.0_wp/steps
    call increment_cayley(dt, l, df)
    do n = 1, steps
      f(:, 2) = n*dt
      call material%advance_state(dt, l, df, f, state, work)
    end do
    g = 6
    error = maxval(abs(state(2, 2:7)/material%mu - [1 - cos(g), cos(g) - 1, 0.0_wp, sin(g), 0.0_wp, 0.0_wp]))
  end subroutine largest_error

  !> A prestressed block turned 100 times keeps its invariants: Hughes-Winget turns by an exact rotation
  subroutine test_hundred_turns()
    class(material_t), allocatable :: material
    integer, parameter :: per_turn = 63
    real(wp) :: l(lanes, 9), stress(lanes, 6), df(lanes, 9), f(lanes, 9), g(lanes, 9), state(lanes, states), work(lanes)
    real(wp) :: tau(lanes, 6), speed2(lanes)
    integer :: n
    call make("hughes_winget", "symmetric", material)
    call random_state(5, l, stress)
    l = 0
    l(:, 2) = -1
    l(:, 4) = 1
    l(:, 6) = 0.3_wp
    l(:, 8) = -0.3_wp
    f = spread(identity, 1, lanes)
    call material%start_state(f, stress, state)
    work = state(:, 1)
    call increment_cayley(2*pi/per_turn, l, df)
    do n = 1, 100*per_turn
      call multiply(df, f, g)
      f = g
      call material%advance_state(2*pi/per_turn, l, df, f, state, speed2)
    end do
    call material%kirchhoff(f, state, tau, speed2)
    ! one rounding per step: sqrt(6300) to 6300 units in the last place
    call check(sum(tau(:, 1:3), 2), sum(stress(:, 1:3), 2), 6.0e-12_wp*100, "trace after 100 turns")
    call check(sum(tau(:, 1:3)**2, 2) + 2*sum(tau(:, 4:6)**2, 2), sum(stress(:, 1:3)**2, 2) + 2*sum(stress(:, 4:6)**2, 2), &
      6.0e-12_wp*1.0e5_wp, "norm after 100 turns")
    call check(state(:, 1), work, 1.0e-10_wp, "a pure spin does no work")
  end subroutine test_hundred_turns

  !> L = W of spin w about z: explicit Jaumann lets the in-plane deviator grow by sqrt(1 + 4 (w dt)^2) per step, Hughes-Winget
  !> turns it by 2 atan(w dt/2)
  subroutine test_pure_spin()
    class(material_t), allocatable :: material
    real(wp), parameter :: theta = 0.2_wp
    real(wp) :: l(lanes, 9), stress(lanes, 6), df(lanes, 9), state(lanes, states), work(lanes), angle
    integer :: n
    l = 0
    l(:, 2) = -1
    l(:, 4) = 1
    stress = 0
    stress(:, 1) = 1
    stress(:, 2) = -1
    call increment_cayley(theta, l, df)
    call make("jaumann", "", material)
    call material%start_state(df, stress, state)
    do n = 1, 10
      call material%advance_state(theta, l, df, df, state, work)
    end do
    call check(sqrt(((state(1, 2) - state(1, 3))/2)**2 + state(1, 5)**2), sqrt(1 + 4*theta**2)**10, 1.0e-14_wp, &
      "explicit Jaumann grows by the known factor")
    call make("hughes_winget", "plain", material)
    call material%start_state(df, stress, state)
    do n = 1, 10
      call material%advance_state(theta, l, df, df, state, work)
    end do
    angle = 20*atan(theta/2)
    call check(state(1, 2:7), [cos(2*angle), -cos(2*angle), 0.0_wp, sin(2*angle), 0.0_wp, 0.0_wp], 1.0e-14_wp, &
      "Hughes-Winget turns by 2 atan(w dt/2)")
  end subroutine test_pure_spin

  !> Stretching along one axis at a steady speed, seen as the grid sees it (gradients with respect to the start of each step):
  !> the stress must follow (lambda + 2 mu) ln(stretch); only the midpoint form does so to second order
  subroutine test_stretch()
    real(wp) :: with_20, with_40
    call stretch_error("midpoint", 20, with_20)
    call stretch_error("midpoint", 40, with_40)
    call check(log(with_20/with_40)/log(2.0_wp), 2.0_wp, 0.05_wp, "midpoint form: order in time of a stretch")
    call stretch_error("symmetric", 20, with_20)
    call stretch_error("symmetric", 40, with_40)
    call check(log(with_20/with_40)/log(2.0_wp), 1.0_wp, 0.05_wp, "L as given: order in time of a stretch")
  end subroutine test_stretch

  subroutine stretch_error(form, steps, error)
    character(len=*), intent(in) :: form
    integer, intent(in) :: steps
    real(wp), intent(out) :: error
    class(material_t), allocatable :: material
    real(wp) :: l(lanes, 9), f(lanes, 9), df(lanes, 9), x(lanes, 9), state(lanes, states), work(lanes), stress(lanes, 6)
    integer :: n
    call make("hughes_winget", form, material)
    f = spread(identity, 1, lanes)
    stress = 0
    call material%start_state(f, stress, state)
    do n = 1, steps
      l = 0
      l(:, 1) = 1.0_wp/f(:, 1) ! the front moves at unit speed: stretch 1 to 2 in unit time
      call increment_forward(1.0_wp/steps, l, df)
      call multiply(df, f, x)
      f = x
      call material%advance_state(1.0_wp/steps, l, df, f, state, work)
    end do
    error = abs(state(1, 2)/(material%lambda + 2*material%mu) - log(2.0_wp))
  end subroutine stretch_error

  !> The whole motion turned by a fixed rotation: the stress is the turned stress, for every scheme
  subroutine test_objectivity()
    character(len=16), parameter :: rates(6) = [character(len=16) :: "hughes_winget", "hughes_winget", "jaumann", &
      "green_naghdi", "truesdell", "logarithmic"]
    character(len=16), parameter :: forms(6) = [character(len=16) :: "symmetric", "plain", "", "", "", ""]
    class(material_t), allocatable :: material
    real(wp), dimension(lanes, 9) :: l, l_turned, q, back, df, df_turned, unit, x
    real(wp) :: stress(lanes, 6), turned(lanes, 6), state(lanes, states), state_turned(lanes, states), work(lanes)
    integer :: k, n, scheme
    unit = spread(identity, 1, lanes)
    do scheme = 1, size(rates)
      call make(trim(rates(scheme)), trim(forms(scheme)), material)
      call random_state(20, l, stress)
      call rotation_cayley(3.0_wp, l, q)
      back = q(:, [1, 4, 7, 2, 5, 8, 3, 6, 9])
      call random_state(21, l, stress)
      call multiply(q, l, x)
      call multiply(x, back, l_turned)
      call push_forward(q, stress, turned)
      call material%start_state(unit, stress, state)
      call material%start_state(unit, turned, state_turned)
      call increment_cayley(0.02_wp, l, df)
      call increment_cayley(0.02_wp, l_turned, df_turned)
      do n = 1, 20
        call material%advance_state(0.02_wp, l, df, df, state, work)
        call material%advance_state(0.02_wp, l_turned, df_turned, df_turned, state_turned, work)
      end do
      call push_forward(q, state(1, 2), turned)
      do k = 1, lanes ! stresses of some hundred, 20 steps
        call check(state_turned(k, 2:7), turned(k, :), 1.0e-11_wp, "turned axes, turned stress")
      end do
      call check(state_turned(:, 1), state(:, 1), 1.0e-10_wp, "turned axes, same energy")
    end do
  end subroutine test_objectivity

  !> Straining to and fro: the books hold the work, which for small strain is the elastic energy, and all of it comes back
  subroutine test_energy()
    class(material_t), allocatable :: material
    real(wp), parameter :: dt = 1.0e-6_wp
    real(wp) :: l(lanes, 9), stress(lanes, 6), f(lanes, 9), g(lanes, 9), df(lanes, 9), df_back(lanes, 9)
    real(wp) :: state(lanes, states), energy(lanes), e(3, 3), expected
    integer :: k, n
    call make("hughes_winget", "symmetric", material)
    call random_state(31, l, stress)
    stress = 0
    f = spread(identity, 1, lanes)
    call material%start_state(f, stress, state)
    call increment_cayley(dt, l, df)
    do n = 1, 10
      call multiply(df, f, g)
      f = g
      call material%advance_state(dt, l, df, f, state, energy)
    end do
    call material%stored_energy(f, state, energy)
    do k = 1, lanes
      e = 10*dt*(full(l(k, :)) + transpose(full(l(k, :))))/2
      expected = material%mu*sum(e**2) + material%lambda/2*(e(1, 1) + e(2, 2) + e(3, 3))**2
      call check(energy(k)/expected, 1.0_wp, 1.0e-4_wp, "the work is the elastic energy, to the strain of 1e-5")
    end do
    call increment_cayley(-dt, l, df_back)
    do n = 1, 10
      call multiply(df_back, f, g)
      f = g
      call material%advance_state(-dt, l, df_back, f, state, energy)
    end do
    call material%stored_energy(f, state, energy)
    call check(energy, spread(0.0_wp, 1, lanes), 1.0e-20_wp, "the energy comes back on the way back") ! it was 1e-7
  end subroutine test_energy

  subroutine test_starting_stress()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), stress(lanes, 6), state(lanes, states), tau(lanes, 6), speed2(lanes), energy(lanes)
    call make("", "", material)
    f = spread(2.0_wp**(1/3.0_wp)*identity, 1, lanes)
    stress = 0
    stress(:, 2) = 30
    call material%start_state(f, stress, state)
    call material%kirchhoff(f, state, tau, speed2)
    call check(tau(4, :), [0.0_wp, 60.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 1.0e-13_wp, "the initial stress is kept")
    call material%stored_energy(f, state, energy)
    call check(energy(4), 2*30**2/2000.0_wp, 1.0e-14_wp, "and stores J s^2/2E")
    call check(speed2(4), 2*(material%lambda + 2*material%mu + 30/sqrt(3.0_wp))/1000, 1.0e-14_wp, "bound of the wave speed")
  end subroutine test_starting_stress

end program test_hypoelastic
