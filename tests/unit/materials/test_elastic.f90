!> The hyperelastic models, and what every model owes: the bound of the wave speed, objectivity, quiet spare lanes
program test_elastic
  use gimp_kinds, only: wp, lanes
  use gimp_error, only: error_t
  use gimp_tensor, only: identity, multiply, determinant, inverse, push_forward, rotation_cayley, eigen_symmetric, &
    increment_cayley
  use gimp_material, only: material_t
  use gimp_material_table, only: make_material, material_options_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  integer, parameter :: most_states = 20

  call begin_suite("elastic")
  call test_values()
  call test_stress_is_derivative("neo_hookean")
  call test_stress_is_derivative("hencky")
  call test_hencky_simple_shear()
  call test_path_independence()
  call test_wave_bound("neo_hookean")
  call test_wave_bound("hencky")
  call test_wave_bound("linear_elastic")
  call test_wave_bound("hencky_von_mises")
  call test_wave_bound("drucker_prager")
  call test_wave_bound_at_large_strain("neo_hookean")
  call test_wave_bound_at_large_strain("hencky")
  call test_wave_bound_at_large_strain("linear_elastic")
  call test_wave_bound("linear_elastic", "green_naghdi")
  call test_wave_bound("linear_elastic", "truesdell")
  call test_wave_bound("linear_elastic", "logarithmic")
  call test_wave_bound_at_large_strain("linear_elastic", "green_naghdi")
  call test_wave_bound_at_large_strain("linear_elastic", "truesdell")
  call test_wave_bound_at_large_strain("linear_elastic", "logarithmic")
  call test_wave_bound_under_pressure()
  call test_wave_bound_in_flow("hencky_von_mises", 5.0_wp)
  call test_wave_bound_in_flow("hencky_von_mises", 100.0_wp)
  call test_wave_bound_in_flow("drucker_prager", 5.0_wp)
  call test_wave_bound_in_flow("drucker_prager", 100.0_wp)
  call test_unstressed_speed()
  call test_objectivity("neo_hookean", 1.0e-13_wp)
  call test_objectivity("hencky", 1.0e-13_wp)
  call test_objectivity("hencky_von_mises", 1.0e-12_wp)
  call test_objectivity("drucker_prager", 1.0e-12_wp)
  call test_spare_lanes()
  call test_inverted_particles()
  call end_suite()

contains

  !> Any of the models with E = 1000, nu = 0.3, rho = 1000; the plastic ones with a strength of the order given
  subroutine make(model, strength, material, rate)
    character(len=*), intent(in) :: model
    character(len=*), intent(in), optional :: rate !! of linear_elastic
    real(wp), intent(in) :: strength
    class(material_t), allocatable, intent(out) :: material
    type(material_options_t) :: options
    type(error_t), allocatable :: error
    options%name = "sample"
    options%model = model
    options%density = 1000
    options%young_modulus = 1000
    options%poisson_ratio = 0.3_wp
    if (model == "hencky_von_mises") then
      options%yield_stress = strength
      options%hardening = "linear"
      options%hardening_modulus = 50
    else if (model == "drucker_prager") then
      options%cohesion = strength
      options%friction_angle = 30
      options%dilation_angle = 10
    end if
    if (present(rate)) options%rate = rate
    call make_material(options, material, error)
    if (allocated(error)) error stop "the sample material is sound"
  end subroutine make

  !> Numbers in (-1, 1), the same on every machine but for round-off
  pure real(wp) function noise(i, seed)
    integer, intent(in) :: i, seed
    noise = sin(real(12*i*i + 71*i + 397*seed, wp))
  end function noise

  !> Deformation gradients I + size*noise with J > 0
  subroutine random_gradient(seed, size, f)
    integer, intent(in) :: seed
    real(wp), intent(in) :: size
    real(wp), intent(out) :: f(lanes, 9)
    real(wp) :: j(lanes)
    integer :: c, k
    do c = 1, 9
      do k = 1, lanes
        f(k, c) = identity(c) + size*noise(9*k + c, seed)
      end do
    end do
    call determinant(f, j)
    do k = 1, lanes
      if (j(k) < 0.02_wp) f(k, :) = 0.7_wp*identity
    end do
  end subroutine random_gradient

  pure function full(a, k) result(matrix)
    real(wp), intent(in) :: a(lanes, 9)
    integer, intent(in) :: k
    real(wp) :: matrix(3, 3)
    matrix = transpose(reshape(a(k, :), [3, 3]))
  end function full

  pure function full_symmetric(s, k) result(matrix)
    real(wp), intent(in) :: s(lanes, 6)
    integer, intent(in) :: k
    real(wp) :: matrix(3, 3)
    matrix = reshape([s(k, 1), s(k, 4), s(k, 6), s(k, 4), s(k, 2), s(k, 5), s(k, 6), s(k, 5), s(k, 3)], [3, 3])
  end function full_symmetric

  !> Uniaxial stretch 1.2: numbers worked out by hand from the formulas
  subroutine test_values()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), tau(lanes, 6), speed2(lanes), energy(lanes), lambda, mu
    lambda = 1000*0.3_wp/(1.3_wp*0.4_wp)
    mu = 1000/2.6_wp
    f = spread(identity, 1, lanes)
    f(:, 1) = 1.2_wp
    state = 0
    call make("neo_hookean", 1.0_wp, material)
    call check(material%states, 0, "neo-Hookean keeps no history")
    call material%kirchhoff(f, state, tau, speed2)
    call check(tau(3, :), [mu*0.44_wp + lambda*log(1.2_wp), lambda*log(1.2_wp), lambda*log(1.2_wp), 0.0_wp, 0.0_wp, 0.0_wp], &
      1.0e-12_wp, "neo-Hookean stress of a uniaxial stretch")
    call check(speed2(3), (lambda*(1 - log(1.2_wp)) + mu + mu*1.44_wp)/1000, 1.0e-14_wp, "its wave speed is exact")
    call material%stored_energy(f, state, energy)
    call check(energy(3), mu*0.22_wp - mu*log(1.2_wp) + lambda/2*log(1.2_wp)**2, 1.0e-12_wp, "its energy")
    call make("hencky", 1.0_wp, material)
    call check(material%states, 0, "Hencky keeps no history")
    call material%kirchhoff(f, state, tau, speed2)
    call check(tau(3, 1:3), log(1.2_wp)*[lambda + 2*mu, lambda, lambda], 1.0e-12_wp, "Hencky stress of a uniaxial stretch")
    call material%stored_energy(f, state, energy)
    call check(energy(3), (mu + lambda/2)*log(1.2_wp)**2, 1.0e-12_wp, "its energy")
  end subroutine test_values

  !> tau = dW/dF F^T, by central differences
  subroutine test_stress_is_derivative(model)
    character(len=*), intent(in) :: model
    class(material_t), allocatable :: material
    real(wp), parameter :: h = 1.0e-5_wp
    real(wp) :: f(lanes, 9), g(lanes, 9), state(lanes, most_states), tau(lanes, 6), speed2(lanes), up(lanes), down(lanes)
    real(wp) :: p(lanes, 9), matrix(3, 3), scale
    integer :: c, k, seed
    call make(model, 1.0_wp, material)
    state = 0
    do seed = 1, 5
      call random_gradient(seed, 0.4_wp, f)
      do c = 1, 9
        g = f
        g(:, c) = f(:, c) + h
        call material%stored_energy(g, state, up)
        g(:, c) = f(:, c) - h
        call material%stored_energy(g, state, down)
        p(:, c) = (up - down)/(2*h)
      end do
      call material%kirchhoff(f, state, tau, speed2)
      do k = 1, lanes
        matrix = matmul(full(p, k), transpose(full(f, k)))
        scale = 1000 + maxval(abs(tau(k, :)))
        ! error h^2 W''' + round-off/h, about 1e-9 of the moduli
        call check(reshape(matrix, [9])/scale, reshape(full_symmetric(tau, k), [9])/scale, 1.0e-7_wp, &
          model//": tau = dW/dF F^T")
      end do
    end do
  end subroutine test_stress_is_derivative

  !> Isochoric simple shear g: b has the eigenvalues exp(+-2 a), sinh a = g/2, axes turned by half of atan(2/g)
  subroutine test_hencky_simple_shear()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), tau(lanes, 6), speed2(lanes), a, angle, mu
    integer :: k
    call make("hencky", 1.0_wp, material)
    mu = material%mu
    f = spread(identity, 1, lanes)
    f(:, 2) = [(0.5_wp*k, k=1, lanes)]
    state = 0
    call material%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes
      a = asinh(0.25_wp*k)
      angle = atan(4.0_wp/k) ! twice the angle of the larger principal axis
      call check(tau(k, :)/mu, 2*a*[cos(angle), -cos(angle), 0.0_wp, sin(angle), 0.0_wp, 0.0_wp], 1.0e-14_wp, &
        "Hencky in simple shear")
    end do
  end subroutine test_hencky_simple_shear

  !> A plastic model below yield integrates to the Hencky law, whatever the path, and gives its energy back
  subroutine test_path_independence()
    class(material_t), allocatable :: hencky, metal
    integer, parameter :: steps = 200
    real(wp) :: f(lanes, 9), g(lanes, 9), df(lanes, 9), l(lanes, 9), state(lanes, most_states), none(lanes, most_states)
    real(wp) :: tau(lanes, 6), expected(lanes, 6), zero(lanes, 6), speed2(lanes), energy(lanes), dissipated(lanes)
    integer :: c, k, n
    call make("hencky", 1.0_wp, hencky)
    call make("hencky_von_mises", 1.0e6_wp, metal)
    none = 0
    zero = 0
    f = spread(identity, 1, lanes)
    call metal%start_state(f, zero, state)
    do n = 1, steps
      do c = 1, 9
        do k = 1, lanes
          l(k, c) = noise(c, k)*cos(0.01_wp*n*c)
        end do
      end do
      call increment_cayley(0.005_wp, l, df)
      call multiply(df, f, g)
      f = g
      call metal%advance_state(0.005_wp, l, df, f, state, dissipated)
    end do
    call hencky%kirchhoff(f, none, expected, speed2)
    call metal%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes
      call check(tau(k, :)/1000, expected(k, :)/1000, 1.0e-13_wp, "below yield: the Hencky law after 200 random steps")
    end do
    call check_true(all(dissipated == 0), "below yield: nothing dissipated")
    call hencky%stored_energy(f, none, speed2)
    call metal%stored_energy(f, state, energy)
    call check(energy/speed2, spread(1.0_wp, 1, lanes), 1.0e-12_wp, "energy from the stress is the energy from the strain")
    call inverse(f, df) ! back to the start at once
    f = spread(identity, 1, lanes)
    call metal%advance_state(1.0_wp, l, df, f, state, dissipated)
    call metal%stored_energy(f, state, energy)
    call check(energy, spread(0.0_wp, 1, lanes), 1.0e-22_wp, "a closed elastic cycle gives all energy back")
  end subroutine test_path_independence

  !> Largest rho0 c^2 over many directions, from the acoustic tensor by central differences of the traction on a wave
  !> L = m (x) n: rho0 Q m = d/dh [tau F_h^-T F^T n]. Q is symmetric for the hyperelastic models; of the hypoelastic one the
  !> symmetric part is taken, whose largest eigenvalue bounds every real one.
  subroutine fastest_wave(material, f, state, found)
    class(material_t), intent(in) :: material
    real(wp), intent(in) :: f(lanes, 9), state(lanes, most_states)
    real(wp), intent(out) :: found(lanes)
    real(wp), parameter :: h = 1.0e-5_wp
    real(wp) :: q(lanes, 9), s(lanes, 6), values(lanes, 3), vectors(lanes, 9), n(3), traction(3, lanes, 2)
    integer :: direction, k, m, side
    found = 0
    do direction = 1, 60
      n = [noise(1, direction), noise(2, direction), noise(3, direction)]
      if (direction <= 3) n = real([1, 2, 3] - direction, wp)
      if (direction <= 3) n = merge(1.0_wp, 0.0_wp, n == 0)
      n = n/norm2(n)
      do m = 1, 3
        do side = 1, 2
          call wave_traction(material, f, state, n, m, merge(h, -h, side == 1), traction(:, :, side))
        end do
        do k = 1, lanes
          q(k, [m, m + 3, m + 6]) = (traction(:, k, 1) - traction(:, k, 2))/(2*h)
        end do
      end do
      s = q(:, [1, 5, 9, 2, 6, 7])
      s(:, 4:6) = (s(:, 4:6) + q(:, [4, 8, 3]))/2
      call eigen_symmetric(s, values, vectors)
      found = max(found, maxval(values, dim=2))
    end do
  end subroutine fastest_wave

  !> tau F_h^-T F^T n after a small step along e_m (x) n
  subroutine wave_traction(material, f, state, n, m, h, traction, work)
    class(material_t), intent(in) :: material
    real(wp), intent(in) :: f(lanes, 9), state(lanes, most_states), n(3), h
    integer, intent(in) :: m
    real(wp), intent(out) :: traction(3, lanes)
    real(wp), intent(out), optional :: work(lanes) !! plastic; without it the samples have to stay elastic
    real(wp) :: l(lanes, 9), df(lanes, 9), g(lanes, 9), back(lanes, 9), history(lanes, most_states)
    real(wp) :: tau(lanes, 6), speed2(lanes), dissipated(lanes)
    integer :: k
    l = 0
    l(:, 3*m - 2:3*m) = spread(n, 1, lanes)
    df = h*l + spread(identity, 1, lanes)
    call multiply(df, f, g)
    history = state
    call material%advance_state(h, l, df, g, history, dissipated)
    if (present(work)) then
      work = dissipated
    else if (any(dissipated > 0)) then
      error stop "the samples stay elastic"
    end if
    call material%kirchhoff(g, history, tau, speed2)
    call inverse(df, back)
    do k = 1, lanes
      traction(:, k) = matmul(full_symmetric(tau, k), matmul(transpose(full(back, k)), n))
    end do
  end subroutine wave_traction

  !> The estimate is never below the fastest wave, and not far above it at moderate strain
  subroutine test_wave_bound(model, rate)
    character(len=*), intent(in) :: model
    character(len=*), intent(in), optional :: rate
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), speed2(lanes), found(lanes), size
    real(wp) :: loosest
    character(len=:), allocatable :: label
    integer :: c, k, seed
    label = model
    if (present(rate)) label = model//" "//rate
    call make(model, 1.0e6_wp, material, rate)
    loosest = 0
    do seed = 1, 12
      size = merge(0.05_wp, 0.5_wp, seed <= 6)
      call random_gradient(seed, size, f)
      f(1, :) = [1.0_wp, size, 0.0_wp, 0.0_wp, 1.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 1.0_wp]
      f(2, :) = (1 - size)*identity
      f(3, :) = (1 + 2*size)*identity
      do c = 1, 6
        do k = 1, lanes
          stress(k, c) = 0.0_wp
          if (model == "linear_elastic") stress(k, c) = 1000*size*noise(6*k + c, seed + 40)
        end do
      end do
      state = 0
      call material%start_state(f, stress, state)
      call material%kirchhoff(f, state, tau, speed2)
      call fastest_wave(material, f, state, found)
      found = found/material%density
      call check_true(all(speed2 >= found*(1 - 1.0e-8_wp)), label//": no wave is faster than the estimate")
      if (seed <= 6) loosest = max(loosest, maxval(speed2/found))
    end do
    call check_true(loosest < 1.25_wp, label//": the estimate is within 12 % of the speed at 5 % strain")
  end subroutine test_wave_bound

  !> The same at stretches between 1/5 and 5 about any axes; the hypoelastic law with stresses of the size of its modulus
  subroutine test_wave_bound_at_large_strain(model, rate)
    character(len=*), intent(in) :: model
    character(len=*), intent(in), optional :: rate
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), speed2(lanes), found(lanes), worst
    character(len=:), allocatable :: label
    integer :: c, k, seed
    label = model
    if (present(rate)) label = model//" "//rate
    call make(model, 1.0e6_wp, material, rate)
    worst = huge(1.0_wp)
    do seed = 1, 12
      call stretched(seed, 5.0_wp, f)
      do c = 1, 6
        do k = 1, lanes
          stress(k, c) = 0.0_wp
          if (model == "linear_elastic") stress(k, c) = 1000*noise(6*k + c, seed + 40)
        end do
      end do
      state = 0
      call material%start_state(f, stress, state)
      call material%kirchhoff(f, state, tau, speed2)
      call fastest_wave(material, f, state, found)
      worst = min(worst, minval(speed2*material%density/max(found, 1.0_wp)))
    end do
    call check_true(worst >= 1 - 1.0e-8_wp, label//": no wave is faster than the estimate at stretches up to 5")
  end subroutine test_wave_bound_at_large_strain

  !> Under pressure (or tension, in odd lanes) alone the bounds of the rates are the fastest wave itself
  subroutine test_wave_bound_under_pressure()
    character(len=16), parameter :: rates(5) = [character(len=16) :: "hughes_winget", "jaumann", "green_naghdi", "truesdell", &
      "logarithmic"]
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), speed2(lanes), found(lanes)
    integer :: k, r
    call stretched(2, 2.0_wp, f)
    stress = 0
    do k = 1, lanes
      stress(k, 1:3) = 40*k*(-1)**(k + 1)
    end do
    do r = 1, size(rates)
      call make("linear_elastic", 1.0_wp, material, trim(rates(r)))
      state = 0
      call material%start_state(f, stress, state)
      call material%kirchhoff(f, state, tau, speed2)
      call fastest_wave(material, f, state, found)
      ! of the difference quotients
      call check(speed2*material%density/found, spread(1.0_wp, 1, lanes), 1.0e-8_wp, trim(rates(r))//": wave speed under pressure")
    end do
  end subroutine test_wave_bound_under_pressure

  !> F = R1 diag(stretches) R2 with stretches between 1/most and most
  subroutine stretched(seed, most, f)
    integer, intent(in) :: seed
    real(wp), intent(in) :: most
    real(wp), intent(out) :: f(lanes, 9)
    real(wp) :: skew(lanes, 9), r(lanes, 9, 2), d(lanes, 9), half(lanes, 9)
    integer :: k, side
    do side = 1, 2
      skew = 0
      do k = 1, lanes
        skew(k, [2, 3, 6]) = 3*[noise(3*k, seed + 100*side), noise(3*k + 1, seed + 100*side), noise(3*k + 2, seed + 100*side)]
        skew(k, [4, 7, 8]) = -skew(k, [2, 3, 6])
      end do
      call increment_cayley(1.0_wp, skew, r(:, :, side))
    end do
    d = 0
    do k = 1, lanes
      d(k, [1, 5, 9]) = most**[noise(3*k, seed), noise(3*k + 1, seed), noise(3*k + 2, seed)]
    end do
    call multiply(d, r(:, :, 2), half)
    call multiply(r(:, :, 1), half, f)
  end subroutine stretched

  !> A material that flows has one stiffness for waves that load it further and the elastic one for all others. The columns of
  !> the acoustic tensor come from whichever of +m and -m loads (one-sided differences); without an associated flow it is not
  !> symmetric, and its symmetric part bounds its eigenvalues.
  subroutine test_wave_bound_in_flow(model, strength)
    character(len=*), intent(in) :: model
    real(wp), intent(in) :: strength
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), speed2(lanes), found(lanes), worst
    integer :: seed
    call make(model, strength, material)
    worst = huge(1.0_wp)
    stress = 0
    do seed = 1, 12
      call stretched(seed, 1.5_wp, f)
      state = 0
      call material%start_state(f, stress, state)
      call material%kirchhoff(f, state, tau, speed2)
      call fastest_in_flow(material, f, state, found)
      worst = min(worst, minval(speed2*material%density/max(found, 1.0_wp)))
    end do
    call check_true(worst >= 1 - 1.0e-5_wp, model//": no wave in flow is faster than the estimate") ! of the difference quotients
  end subroutine test_wave_bound_in_flow

  subroutine fastest_in_flow(material, f, state, found)
    class(material_t), intent(in) :: material
    real(wp), intent(in) :: f(lanes, 9), state(lanes, most_states)
    real(wp), intent(out) :: found(lanes)
    real(wp), parameter :: h = 1.0e-7_wp
    real(wp) :: q(lanes, 9), s(lanes, 6), values(lanes, 3), vectors(lanes, 9), n(3), at_rest(3, lanes), traction(3, lanes, 2)
    real(wp) :: work(lanes, 2)
    integer :: direction, k, m
    found = 0
    do direction = 1, 60
      n = [noise(1, direction), noise(2, direction), noise(3, direction)]
      n = n/norm2(n)
      do m = 1, 3
        call wave_traction(material, f, state, n, m, 0.0_wp, at_rest, work(:, 1))
        call wave_traction(material, f, state, n, m, h, traction(:, :, 1), work(:, 1))
        call wave_traction(material, f, state, n, m, -h, traction(:, :, 2), work(:, 2))
        do k = 1, lanes
          if (work(k, 1) >= work(k, 2)) then
            q(k, [m, m + 3, m + 6]) = (traction(:, k, 1) - at_rest(:, k))/h
          else
            q(k, [m, m + 3, m + 6]) = (at_rest(:, k) - traction(:, k, 2))/h
          end if
        end do
      end do
      s = q(:, [1, 5, 9, 2, 6, 7])
      s(:, 4:6) = (s(:, 4:6) + q(:, [4, 8, 3]))/2
      call eigen_symmetric(s, values, vectors)
      found = max(found, maxval(values, dim=2))
    end do
  end subroutine fastest_in_flow

  subroutine test_unstressed_speed()
    character(len=16), parameter :: models(5) = [character(len=16) :: "neo_hookean", "hencky", "linear_elastic", &
      "hencky_von_mises", "drucker_prager"]
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), speed2(lanes)
    integer :: m
    do m = 1, size(models)
      call make(trim(models(m)), 10.0_wp, material)
      f = spread(identity, 1, lanes)
      stress = 0
      state = 0
      call material%start_state(f, stress, state)
      call material%kirchhoff(f, state, tau, speed2)
      call check(sqrt(speed2(5)), material%initial_speed(), 4*round_off, trim(models(m))//": speed without stress")
      call check(material%initial_speed(), sqrt(1000/(1.3_wp*0.4_wp)*0.7_wp/1000), 4*round_off, "sqrt((lambda + 2 mu)/rho)")
    end do
  end subroutine test_unstressed_speed

  !> Turning the body after every step turns the stress and changes neither energy nor dissipation
  subroutine test_objectivity(model, tolerance)
    character(len=*), intent(in) :: model
    real(wp), intent(in) :: tolerance !! of the modulus: round-off added up over 40 steps
    class(material_t), allocatable :: material
    real(wp), dimension(lanes, 9) :: f, f_turned, l, df, df_turned, q, q_new, x, y
    real(wp) :: state(lanes, most_states), turned(lanes, most_states), tau(lanes, 6), tau_turned(lanes, 6), expected(lanes, 6)
    real(wp) :: speed2(lanes), work(lanes), work_turned(lanes), stress(lanes, 6)
    integer :: c, k, n
    call make(model, 20.0_wp, material)
    stress = 0
    call random_gradient(3, 0.05_wp, f)
    f_turned = f
    q = spread(identity, 1, lanes)
    state = 0
    call material%start_state(f, stress, state)
    turned = state
    do n = 1, 40
      do c = 1, 9
        do k = 1, lanes
          l(k, c) = noise(c, k)
        end do
      end do
      call increment_cayley(0.005_wp, l, df)
      call multiply(df, f, x)
      f = x
      call material%advance_state(0.005_wp, l, df, f, state, work)
      call rotation_cayley(0.07_wp*n, l, q_new) ! F* = Q_new F, dF* = Q_new dF Q_old^T
      y = q(:, [1, 4, 7, 2, 5, 8, 3, 6, 9])
      call multiply(df, y, x)
      call multiply(q_new, x, df_turned)
      call multiply(df_turned, f_turned, x)
      f_turned = x
      q = q_new
      call material%advance_state(0.005_wp, l, df_turned, f_turned, turned, work_turned)
    end do
    call material%kirchhoff(f, state, tau, speed2)
    call material%kirchhoff(f_turned, turned, tau_turned, speed2)
    call push_forward(q, tau, expected)
    do k = 1, lanes
      call check(tau_turned(k, :)/1000, expected(k, :)/1000, tolerance, model//": the stress turns with the body")
    end do
    call check(work_turned, work, 1.0e-11_wp, model//": the dissipation does not notice")
    if (material%states > 0) call check_true(count(work > 0) >= lanes/2, model//": most samples yield")
  end subroutine test_objectivity

  !> Lanes without a particle hold F = I and L = 0 and must stay at rest for ever
  subroutine test_spare_lanes()
    character(len=16), parameter :: models(5) = [character(len=16) :: "neo_hookean", "hencky", "linear_elastic", &
      "hencky_von_mises", "drucker_prager"]
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), l(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), x(lanes)
    integer :: m, n
    f = spread(identity, 1, lanes)
    l = 0
    stress = 0
    do m = 1, size(models)
      call make(trim(models(m)), merge(0.0_wp, 5.0_wp, models(m) == "drucker_prager"), material)
      state = -7
      call material%start_state(f, stress, state)
      call check_true(all(state(:, material%states + 1:) == -7), trim(models(m))//": touches no more than its history")
      call check_true(all(state(:, :material%states) /= -7), trim(models(m))//": sets all of its history")
      do n = 1, 10
        call material%advance_state(0.1_wp, l, f, f, state, x)
        call check(x, spread(0.0_wp, 1, lanes), 0.0_wp, trim(models(m))//": spare lanes dissipate nothing")
      end do
      call material%kirchhoff(f, state, tau, x)
      call check(reshape(tau, [6*lanes]), spread(0.0_wp, 1, 6*lanes), 0.0_wp, trim(models(m))//": spare lanes bear no stress")
      call material%stored_energy(f, state, x)
      call check(x, spread(0.0_wp, 1, lanes), 0.0_wp, trim(models(m))//": spare lanes store nothing")
      call material%equivalent_plastic_strain(state, x)
      call check(x, spread(0.0_wp, 1, lanes), 0.0_wp, trim(models(m))//": spare lanes have not flowed")
    end do
  end subroutine test_spare_lanes

  !> An inverted or flat particle is the caller's error to report: no NaN and no trap on the way there
  subroutine test_inverted_particles()
    character(len=16), parameter :: models(5) = [character(len=16) :: "neo_hookean", "hencky", "linear_elastic", &
      "hencky_von_mises", "drucker_prager"]
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), df(lanes, 9), l(lanes, 9), state(lanes, most_states), stress(lanes, 6), tau(lanes, 6), x(lanes)
    integer :: m, k
    stress = 0
    do m = 1, size(models)
      call make(trim(models(m)), 5.0_wp, material)
      f = spread(identity, 1, lanes)
      state = 0
      call material%start_state(f, stress, state)
      do k = 1, lanes
        df(k, :) = identity*[-1, 0, 0, 0, 1, 0, 0, 0, 1]
        if (k > 3) df(k, :) = identity*[0, 0, 0, 0, 1, 0, 0, 0, 1]
        if (k > 5) df(k, :) = 0
      end do
      l = df - f
      call material%advance_state(1.0_wp, l, df, df, state, x)
      call check_true(all(abs(state(:, :material%states)) <= huge(1.0_wp)), trim(models(m))//": history stays finite")
      call material%kirchhoff(df, state, tau, x)
      call check_true(all(abs(tau) <= huge(1.0_wp)) .and. all(abs(x) <= huge(1.0_wp)), trim(models(m))//": stress too")
      call material%stored_energy(df, state, x)
      call check_true(all(abs(x) <= huge(1.0_wp)), trim(models(m))//": energy too")
    end do
  end subroutine test_inverted_particles

end program test_elastic
