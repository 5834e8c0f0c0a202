!> The objective rates beside Jaumann's: one step against its formulas, simple shear against closed forms, superposed rotation,
!> many turns, and the logarithmic rate against the Hencky law it integrates to
program test_objective_rates
  use gimp_kinds, only: wp, lanes, pi
  use gimp_error, only: error_t
  use gimp_tensor, only: identity, multiply, inverse, increment_cayley, increment_forward, increment_exponential, rotation_cayley, &
    eigen_symmetric, left_cauchy_green
  use gimp_material, only: material_t, most_states
  use gimp_material_table, only: make_material, material_options_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  character(len=16), parameter :: new_rates(3) = [character(len=16) :: "green_naghdi", "truesdell", "logarithmic"]
  character(len=16), parameter :: sound_rates(4) = [character(len=16) :: "hughes_winget", "green_naghdi", "truesdell", "logarithmic"]

  call begin_suite("objective_rates")
  call test_one_step()
  call test_simple_shear()
  call test_superposed_rotation()
  call test_hundred_turns()
  call test_hencky_on_a_path()
  call test_increments()
  call test_equal_stretches()
  call end_suite()

contains

  !> E = 1000, nu = 0.3, rho = 1000
  subroutine make(rate, material, form, of_middle)
    character(len=*), intent(in) :: rate
    class(material_t), allocatable, intent(out) :: material
    character(len=*), intent(in), optional :: form
    logical, intent(in), optional :: of_middle !! L is that of the middle of the step
    type(material_options_t) :: options
    type(error_t), allocatable :: error
    options%name = "sample"
    options%model = merge("hencky        ", "linear_elastic", rate == "hencky")
    options%density = 1000
    options%young_modulus = 1000
    options%poisson_ratio = 0.3_wp
    if (rate /= "hencky") options%rate = rate
    if (present(form)) options%rate_form = form
    if (present(of_middle)) options%gradient_of_middle = of_middle
    call make_material(options, material, error)
    if (allocated(error)) error stop "the sample material is sound"
  end subroutine make

  pure real(wp) function noise(i, seed)
    integer, intent(in) :: i, seed
    noise = sin(real(12*i*i + 71*i + 397*seed, wp))
  end function noise

  subroutine random_tensors(seed, size, a)
    integer, intent(in) :: seed
    real(wp), intent(in) :: size
    real(wp), intent(out) :: a(:, :)
    integer :: c, k
    do c = 1, ubound(a, 2)
      do k = 1, ubound(a, 1)
        a(k, c) = size*noise(9*k + c, seed)
      end do
    end do
  end subroutine random_tensors

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

  pure function flat(matrix) result(a)
    real(wp), intent(in) :: matrix(3, 3)
    real(wp) :: a(9)
    a = reshape(transpose(matrix), [9])
  end function flat

  pure real(wp) function det(a)
    real(wp), intent(in) :: a(3, 3)
    det = a(1, 1)*(a(2, 2)*a(3, 3) - a(2, 3)*a(3, 2)) - a(1, 2)*(a(2, 1)*a(3, 3) - a(2, 3)*a(3, 1)) &
      + a(1, 3)*(a(2, 1)*a(3, 2) - a(2, 2)*a(3, 1))
  end function det

  !> Rotation of F as F (F^T F)^-1/2, from principal axes
  function rotation_of(f) result(r)
    real(wp), intent(in) :: f(3, 3)
    real(wp) :: r(3, 3), c(lanes, 6), values(lanes, 3), n(lanes, 9), axes(3, 3)
    call left_cauchy_green(spread(flat(transpose(f)), 1, lanes), c)
    call eigen_symmetric(c, values, n)
    axes = full(n(1, :))
    r = matmul(f, matmul(axes*spread(1/sqrt(values(1, :)), 1, 3), transpose(axes)))
  end function rotation_of

  !> The spin of the logarithmic rate as it is written: W + sum [(1 + r)/(1 - r) + 2/ln r] P_A D P_B
  function logarithmic_spin(l, f) result(spin)
    real(wp), intent(in) :: l(3, 3), f(3, 3)
    real(wp) :: spin(3, 3), b(lanes, 6), values(lanes, 3), n(lanes, 9), p(3, 3, 3), r
    integer :: i, j
    call left_cauchy_green(spread(flat(f), 1, lanes), b)
    call eigen_symmetric(b, values, n)
    do i = 1, 3
      p(:, :, i) = spread(n(1, [i, i + 3, i + 6]), 2, 3)*spread(n(1, [i, i + 3, i + 6]), 1, 3)
    end do
    spin = (l - transpose(l))/2
    do i = 1, 3
      do j = 1, 3
        if (i == j) cycle
        r = values(1, i)/values(1, j)
        spin = spin + ((1 + r)/(1 - r) + 2/log(r))*matmul(p(:, :, i), matmul((l + transpose(l))/2, p(:, :, j)))
      end do
    end do
  end function logarithmic_spin

  !> One step with L as given, from a deformed and stressed state, against the formulas written with 3x3 arrays
  subroutine test_one_step()
    class(material_t), allocatable :: material
    real(wp), parameter :: dt = 0.1_wp
    real(wp) :: l(lanes, 9), f(lanes, 9), g(lanes, 9), df(lanes, 9), q(lanes, 9), stress(lanes, 6), state(lanes, most_states)
    real(wp) :: tau(lanes, 6), work(lanes)
    real(wp), dimension(3, 3) :: d, s, a, expected, eye, new, old, step, turn, r
    integer :: k, n
    eye = full(identity)
    do n = 1, 3
      call make(trim(new_rates(n)), material, form="symmetric")
      call random_tensors(n, 1.0_wp, l)
      call random_tensors(n + 5, 0.3_wp, f)
      f = f + spread(identity, 1, lanes)
      call random_tensors(n + 9, 100.0_wp, stress)
      state = 0
      call material%start_state(f, stress, state)
      call increment_forward(dt, l, df)
      call multiply(df, f, g)
      call material%advance_state(dt, l, df, g, state, work)
      call material%kirchhoff(g, state, tau, work)
      do k = 1, lanes
        new = full(g(k, :))
        old = full(f(k, :))
        step = full(df(k, :))
        d = (full(l(k, :)) + transpose(full(l(k, :))))/2
        s = full_symmetric(stress(k, :))
        a = dt*(material%lambda*(d(1, 1) + d(2, 2) + d(3, 3))*eye + 2*material%mu*d)/2
        select case (n)
        case (1)
          r = rotation_of(old)
          turn = rotation_of((old + new)/2)
          expected = matmul(transpose(r), matmul(s, r)) + matmul(transpose(turn), matmul(2*a, turn))
          r = rotation_of(new)
          expected = matmul(r, matmul(expected, transpose(r)))
        case (2)
          expected = matmul(step, matmul(s + a, transpose(step)))/det(step) + a
        case (3)
          q = spread(flat(logarithmic_spin(full(l(k, :)), (old + new)/2)), 1, lanes)
          call rotation_cayley(dt, q, df)
          turn = full(df(k, :))
          expected = (matmul(turn, matmul(s*det(old) + a, transpose(turn))) + a)/det(new)
          df(k, :) = flat(step)
        end select
        ! the formula of the spin loses digits where two stretches are alike: some 1e-14 of the stress
        call check(reshape(full_symmetric(tau(k, :))/det(new), [9]), reshape(expected, [9]), 1.0e-10_wp, &
          trim(new_rates(n))//": one step")
        if (n == 3) call increment_forward(dt, l, df)
      end do
    end do
  end subroutine test_one_step

  !> The closed forms of isochoric simple shear at G = 1, from the stress-free state (algorithms 12.2): [s11, s22, s33, s12, s23, s31]
  pure function closed_form(rate, g) result(s)
    character(len=*), intent(in) :: rate
    real(wp), intent(in) :: g
    real(wp) :: s(6), b
    b = atan(g/2)
    select case (rate)
    case ("hughes_winget")
      s = [1 - cos(g), cos(g) - 1, 0.0_wp, sin(g), 0.0_wp, 0.0_wp]
    case ("green_naghdi")
      s(1) = 4*(cos(2*b)*log(cos(b)) + b*sin(2*b) - sin(b)**2)
      s = [s(1), -s(1), 0.0_wp, 2*(2*b*cos(2*b) - 2*sin(2*b)*log(cos(b)) - cos(2*b)*tan(b)), 0.0_wp, 0.0_wp]
    case ("truesdell")
      s = [g*g, 0.0_wp, 0.0_wp, g, 0.0_wp, 0.0_wp]
    case ("logarithmic") ! the Hencky law: b has the eigenvalues exp(+-2 a), sinh a = g/2, axes turned by half of atan(2/g)
      s = 2*asinh(g/2)*[cos(atan(2/g)), -cos(atan(2/g)), 0.0_wp, sin(atan(2/g)), 0.0_wp, 0.0_wp]
    end select
  end function closed_form

  !> F(t) = Q(t) (I + g t e1 (x) e2), 0 <= t <= 1, Q a turn by `angle` t about an oblique axis: the largest error of the stress turned back
  subroutine shear_error(rate, g, angle, steps, error)
    character(len=*), intent(in) :: rate
    real(wp), intent(in) :: g, angle
    integer, intent(in) :: steps
    real(wp), intent(out) :: error
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), old(lanes, 9), back(lanes, 9), df(lanes, 9), l(lanes, 9), stress(lanes, 6), state(lanes, most_states)
    real(wp) :: work(lanes), tau(lanes, 6), q(3, 3), s(3, 3), dt
    integer :: n
    call make(rate, material)
    dt = 1.0_wp/steps
    f = spread(identity, 1, lanes)
    stress = 0
    call material%start_state(f, stress, state)
    do n = 1, steps
      old = f
      q = turn(angle*n*dt)
      f = spread(flat(matmul(q, sheared(g*n*dt))), 1, lanes)
      call inverse(old, back)
      call multiply(f, back, df)
      l = (df - spread(identity, 1, lanes))/dt ! as the grid sees it: with respect to the start of the step
      call material%advance_state(dt, l, df, f, state, work)
    end do
    call material%kirchhoff(f, state, tau, work)
    s = matmul(transpose(q), matmul(full_symmetric(tau(2, :)), q))/material%mu
    error = maxval(abs(s - full_symmetric(closed_form(rate, g))))
  end subroutine shear_error

  pure function sheared(g) result(f)
    real(wp), intent(in) :: g
    real(wp) :: f(3, 3)
    f = full(identity)
    f(1, 2) = g
  end function sheared

  !> Rotation about (1, 2, 2)/3 (Rodrigues)
  pure function turn(angle) result(q)
    real(wp), intent(in) :: angle
    real(wp) :: q(3, 3), w(3, 3)
    w = reshape([0.0_wp, 2.0_wp, -2.0_wp, -2.0_wp, 0.0_wp, 1.0_wp, 2.0_wp, -1.0_wp, 0.0_wp], [3, 3])/3
    q = full(identity) + sin(angle)*w + (1 - cos(angle))*matmul(w, w)
  end function turn

  !> Simple shear to g = 2: second order, and the numbers of the closed forms
  subroutine test_simple_shear()
    real(wp), parameter :: known(2, 4) = reshape([0.909297_wp, 1.416147_wp, 1.386294_wp, 1.141593_wp, 2.0_wp, 4.0_wp, &
      1.246450_wp, 1.246450_wp], [2, 4])
    integer :: n
    do n = 1, size(sound_rates)
      call shear_of_rate(trim(sound_rates(n)), known(:, n))
    end do
  end subroutine test_simple_shear

  subroutine shear_of_rate(rate, known)
    character(len=*), intent(in) :: rate
    real(wp), intent(in) :: known(2) !! s12 and s11
    real(wp) :: with_100, with_200, s(6)
    s = closed_form(rate, 2.0_wp)
    call check(s([4, 1]), known, 1.0e-6_wp, rate//": closed form at g = 2")
    call shear_error(rate, 2.0_wp, 0.0_wp, 100, with_100)
    call shear_error(rate, 2.0_wp, 0.0_wp, 200, with_200)
    if (rate == "truesdell") then ! D is constant, and dF s dF^T is the exact push-forward
      call check(max(with_100, with_200), 0.0_wp, 1.0e-12_wp, "truesdell: exact in simple shear")
    else
      call check(log(with_100/with_200)/log(2.0_wp), 2.0_wp, 0.02_wp, rate//": order in time of simple shear")
      call check(with_200, 0.0_wp, 5.0e-5_wp, rate//": error of simple shear with 200 steps")
    end if
  end subroutine shear_of_rate

  !> The same while the whole body turns by 3 about an oblique axis: the stress turns with it, and the order stays 2
  subroutine test_superposed_rotation()
    real(wp) :: with_200, with_400
    integer :: n
    do n = 1, size(sound_rates)
      call shear_error(trim(sound_rates(n)), 2.0_wp, 3.0_wp, 200, with_200)
      call shear_error(trim(sound_rates(n)), 2.0_wp, 3.0_wp, 400, with_400)
      call check(log(with_200/with_400)/log(2.0_wp), 2.0_wp, 0.02_wp, trim(sound_rates(n))//": order under superposed rotation")
      call check(with_400, 0.0_wp, 2.0e-4_wp, trim(sound_rates(n))//": error under superposed rotation")
    end do
  end subroutine test_superposed_rotation

  !> A prestressed, stretched point that turns 100 times keeps the invariants of its stress where dF is a rotation. Explicit
  !> Jaumann cannot: I + dt W is no rotation. Neither can a form that takes L as it is where that is the chord of a rotation.
  subroutine test_hundred_turns()
    real(wp) :: change
    integer :: r
    do r = 1, size(sound_rates)
      call turn_a_hundred_times(trim(sound_rates(r)), "midpoint", .false., change)
      call check(change, 0.0_wp, 1.0e-10_wp, trim(sound_rates(r))//": invariants after 100 turns, L = W") ! 6300 steps of some round-off each
      call turn_a_hundred_times(trim(sound_rates(r)), "midpoint", .true., change)
      call check(change, 0.0_wp, 1.0e-10_wp, trim(sound_rates(r))//": invariants after 100 turns, L of the chord")
      call turn_a_hundred_times(trim(sound_rates(r)), "symmetric", .true., change)
      call check_true(change > 1.0e-3_wp, trim(sound_rates(r))//": the L of the chord as it is strains")
    end do
    call turn_a_hundred_times("hughes_winget", "plain", .false., change)
    call check(change, 0.0_wp, 1.0e-10_wp, "plain form: invariants after 100 turns, L = W")
    call turn_a_hundred_times("jaumann", "", .false., change)
    call check_true(change > 1.0_wp, "explicit Jaumann does not keep the invariants")
  end subroutine test_hundred_turns

  !> Change of the invariants, and of the energy where L = W, against powers of the stress
  subroutine turn_a_hundred_times(rate, form, chord, change)
    character(len=*), intent(in) :: rate, form
    logical, intent(in) :: chord !! L = (dF - I)/dt, else dF is the Cayley increment of L = W
    real(wp), intent(out) :: change
    class(material_t), allocatable :: material
    integer, parameter :: per_turn = 63
    real(wp), parameter :: dt = 2*pi/per_turn
    real(wp) :: l(lanes, 9), stress(lanes, 6), df(lanes, 9), f(lanes, 9), g(lanes, 9), state(lanes, most_states), work(lanes)
    real(wp) :: tau(lanes, 6), before(3), after(3), energy(lanes)
    integer :: k, n
    call make(rate, material, form=form, of_middle=.not. chord)
    call random_tensors(5, 100.0_wp, stress)
    call random_tensors(6, 0.2_wp, f)
    f = f + spread(identity, 1, lanes)
    l = spread([0.0_wp, -1.0_wp, 0.2_wp, 1.0_wp, 0.0_wp, 0.3_wp, -0.2_wp, -0.3_wp, 0.0_wp], 1, lanes)
    call material%start_state(f, stress, state)
    call material%stored_energy(f, state, energy)
    call material%kirchhoff(f, state, tau, work)
    stress = tau
    call increment_cayley(dt, l, df)
    if (chord) l = (df - spread(identity, 1, lanes))/dt
    do n = 1, 100*per_turn
      call multiply(df, f, g)
      f = g
      call material%advance_state(dt, l, df, f, state, work)
    end do
    call material%kirchhoff(f, state, tau, work)
    change = 0
    do k = 1, lanes
      before = invariants(full_symmetric(stress(k, :)))
      after = invariants(full_symmetric(tau(k, :)))
      change = max(change, maxval(abs(after - before)/norm2(stress(k, :))**[1, 2, 3]))
    end do
    call material%stored_energy(f, state, work)
    if (form /= "symmetric" .and. rate /= "jaumann") change = max(change, maxval(abs(work - energy))/norm2(stress(1, :)))
  end subroutine turn_a_hundred_times

  !> Powers of the trace: tr s, tr s^2, tr s^3
  pure function invariants(s) result(i)
    real(wp), intent(in) :: s(3, 3)
    real(wp) :: i(3), square(3, 3), cube(3, 3)
    integer :: k
    square = matmul(s, s)
    cube = matmul(square, s)
    i = 0
    do k = 1, 3
      i = i + [s(k, k), square(k, k), cube(k, k)]
    end do
  end function invariants

  !> Along a path of large strain, rotation and change of volume, each lane its own, the logarithmic rate follows the Hencky law
  !> to second order, energy included, and back at the start nothing is left; no other rate does either
  subroutine test_hencky_on_a_path()
    real(wp) :: coarse(3), fine(3), other(3)
    integer :: n
    call path_errors("logarithmic", 400, coarse)
    call path_errors("logarithmic", 800, fine)
    call check(log(coarse/fine)/log(2.0_wp), spread(2.0_wp, 1, 3), 0.05_wp, "logarithmic: order of stress, energy, closed path")
    call check(fine, spread(0.0_wp, 1, 3), 5.0e-6_wp, "logarithmic: the Hencky law on a path")
    do n = 1, 3
      call path_errors(trim(sound_rates(n)), 400, other)
      call check_true(other(1) > 0.02_wp .and. other(3) > 0.02_wp, trim(sound_rates(n))//": depends on the path")
    end do
  end subroutine test_hencky_on_a_path

  !> Largest error, of E, of the Kirchhoff stress and of the energy half-way around a closed path, and of the stress at its end
  subroutine path_errors(rate, steps, errors)
    character(len=*), intent(in) :: rate
    integer, intent(in) :: steps
    real(wp), intent(out) :: errors(3)
    class(material_t), allocatable :: material, hencky
    real(wp) :: f(lanes, 9), old(lanes, 9), back(lanes, 9), df(lanes, 9), l(lanes, 9), stress(lanes, 6), state(lanes, most_states)
    real(wp) :: work(lanes), tau(lanes, 6), expected(lanes, 6), energy(lanes), dt, t
    integer :: c, k, n
    call make(rate, material)
    call make("hencky", hencky)
    dt = 1.0_wp/steps
    f = spread(identity, 1, lanes)
    stress = 0
    call material%start_state(f, stress, state)
    do n = 1, steps
      old = f
      t = n*dt
      do c = 1, 9
        do k = 1, lanes ! two turns about different axes keep the way there and back apart
          l(k, c) = identity(c) + 0.3_wp*noise(9*k + c, 3)*sin(pi*t)**2 + 0.2_wp*noise(9*k + c, 8)*sin(2*pi*t)
        end do
      end do
      f = l
      call inverse(old, back)
      call multiply(f, back, df)
      l = (df - spread(identity, 1, lanes))/dt
      call material%advance_state(dt, l, df, f, state, work)
      if (n /= steps/2 .and. n /= steps) cycle
      call material%kirchhoff(f, state, tau, work)
      call hencky%kirchhoff(f, state, expected, work)
      errors(merge(3, 1, n == steps)) = maxval(abs(tau - expected))/1000
      if (n == steps) cycle
      call material%stored_energy(f, state, energy)
      call hencky%stored_energy(f, state, work)
      errors(2) = maxval(abs(energy - work))/1000
    end do
  end subroutine path_errors

  !> Constant L integrated with each increment of F: the law takes D and W to the middle of the step where they do not stand there
  !> already, and stays of second order with respect to its own F
  subroutine test_increments()
    real(wp) :: coarse, fine
    integer :: increment
    do increment = 1, 3
      call constant_gradient_error(increment, 50, coarse)
      call constant_gradient_error(increment, 100, fine)
      call check(log(coarse/fine)/log(2.0_wp), 2.0_wp, 0.05_wp, "every increment of F: order of the logarithmic rate")
    end do
  end subroutine test_increments

  subroutine constant_gradient_error(increment, steps, error)
    integer, intent(in) :: increment !! 1 forward, 2 Cayley, 3 exponential
    integer, intent(in) :: steps
    real(wp), intent(out) :: error
    class(material_t), allocatable :: material, hencky
    real(wp) :: f(lanes, 9), g(lanes, 9), df(lanes, 9), l(lanes, 9), stress(lanes, 6), state(lanes, most_states), work(lanes)
    real(wp) :: tau(lanes, 6), expected(lanes, 6)
    integer :: n
    call make("logarithmic", material, of_middle=increment > 1)
    call make("hencky", hencky)
    call random_tensors(12, 0.7_wp, l)
    f = spread(identity, 1, lanes)
    stress = 0
    call material%start_state(f, stress, state)
    if (increment == 1) call increment_forward(1.0_wp/steps, l, df)
    if (increment == 2) call increment_cayley(1.0_wp/steps, l, df)
    if (increment == 3) call increment_exponential(1.0_wp/steps, l, df)
    do n = 1, steps
      call multiply(df, f, g)
      f = g
      call material%advance_state(1.0_wp/steps, l, df, f, state, work)
    end do
    call material%kirchhoff(f, state, tau, work)
    call hencky%kirchhoff(f, state, expected, work)
    error = maxval(abs(tau - expected))/1000
  end subroutine constant_gradient_error

  !> Equal and nearly equal stretches are no special case of the logarithmic spin: a step from F = (1 + gap) in one axis changes
  !> smoothly with the gap, over the limit between the two ways its factor is computed too (stretch ratio e = 2.718)
  subroutine test_equal_stretches()
    class(material_t), allocatable :: material
    real(wp), parameter :: gaps(9) = [0.0_wp, 1.0e-14_wp, 1.0e-9_wp, 1.0e-5_wp, 1.0e-3_wp, 0.3_wp, 1.71_wp, 1.73_wp, 9.0_wp]
    real(wp) :: f(lanes, 9), g(lanes, 9), df(lanes, 9), l(lanes, 9), stress(lanes, 6), state(lanes, most_states), work(lanes)
    real(wp) :: x, c, spin, expected
    integer :: n
    call make("logarithmic", material, of_middle=.true.)
    do n = 1, size(gaps)
      f = spread(identity, 1, lanes)
      f(:, 1) = 1 + gaps(n)
      l = 0
      l(:, 2) = 1.0e-7_wp ! D12 = -W21 = 5e-8
      l(:, 4) = 1.0e-7_wp
      stress = 0
      stress(:, 1) = 1.0e9_wp/f(1, 1)
      call material%start_state(f, stress, state)
      call increment_forward(1.0_wp, l, df)
      call multiply(df, f, g)
      call material%advance_state(1.0_wp, l, df, g, state, work)
      x = log(f(1, 1)) ! half the logarithm of the ratio of the eigenvalues of b
      c = -x/3
      if (x > 0.01_wp) c = 1/x - 1/tanh(x)
      spin = c*1.0e-7_wp ! S12; a turn of 1e-7 moves S21 s11 into s12
      expected = -spin*1.0e9_wp + 2*material%mu*1.0e-7_wp
      call check(state(3, 5), expected, 1.0e-6_wp*100, "spin where two stretches are alike") ! of spins squared and of x^3/45
    end do
  end subroutine test_equal_stretches

end program test_objective_rates
