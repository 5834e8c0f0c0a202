!> Return mappings: published numbers, paths with closed forms, hardening against a scalar solve, dissipation
program test_plastic
  use gimp_kinds, only: wp, lanes
  use gimp_error, only: error_t
  use gimp_tensor, only: identity, increment_exponential, multiply, inverse
  use gimp_material, only: material_t
  use gimp_material_table, only: make_material, material_options_t
  use gimp_drucker_prager, only: drucker_prager_t
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer, parameter :: states = 7

  call begin_suite("plastic")
  call test_j2_numbers()
  call test_drucker_prager_numbers()
  call test_uniaxial_strain()
  call test_uniaxial_stress()
  call test_power_hardening()
  call test_energy_balance()
  call test_cones_touch_mohr_coulomb()
  call test_frictionless_cone()
  call test_cohesionless_tension()
  call test_starting_stress()
  call end_suite()

contains

  !> A material from bulk and shear modulus; the rest of the options as given
  subroutine make(options, bulk, shear, material)
    type(material_options_t), intent(inout) :: options
    real(wp), intent(in) :: bulk, shear
    class(material_t), allocatable, intent(out) :: material
    type(error_t), allocatable :: error
    options%name = "sample"
    options%density = 1000
    options%young_modulus = 9*bulk*shear/(3*bulk + shear)
    options%poisson_ratio = (3*bulk - 2*shear)/(2*(3*bulk + shear))
    call make_material(options, material, error)
    if (allocated(error)) error stop "the sample material is sound"
  end subroutine make

  subroutine make_metal(bulk, shear, yield, modulus, material)
    real(wp), intent(in) :: bulk, shear, yield, modulus
    class(material_t), allocatable, intent(out) :: material
    type(material_options_t) :: options
    options%model = "hencky_von_mises"
    options%yield_stress = yield
    if (modulus > 0) then
      options%hardening = "linear"
      options%hardening_modulus = modulus
    end if
    call make(options, bulk, shear, material)
  end subroutine make_metal

  subroutine make_soil(bulk, shear, cohesion, friction, dilation, cone, material)
    real(wp), intent(in) :: bulk, shear, cohesion, friction, dilation
    character(len=*), intent(in) :: cone
    class(material_t), allocatable, intent(out) :: material
    type(material_options_t) :: options
    options%model = "drucker_prager"
    options%cohesion = cohesion
    options%friction_angle = friction
    options%dilation_angle = dilation
    options%cone = cone
    call make(options, bulk, shear, material)
  end subroutine make_soil

  !> dF = exp(strain increment) in every lane; components xx, yy, zz, xy, yz, zx
  subroutine strain_increment(de, df)
    real(wp), intent(in) :: de(lanes, 6)
    real(wp), intent(out) :: df(lanes, 9)
    call increment_exponential(1.0_wp, de(:, [1, 4, 6, 4, 2, 5, 6, 5, 3]), df)
  end subroutine strain_increment

  !> Strain a material that starts unstressed, in one step, and give stress and plastic strain
  subroutine strain_once(material, strain, tau, ep, dissipated)
    class(material_t), intent(in) :: material
    real(wp), intent(in) :: strain(lanes, 6)
    real(wp), intent(out) :: tau(lanes, 6), ep(lanes), dissipated(lanes)
    real(wp) :: unit(lanes, 9), df(lanes, 9), zero(lanes, 6), state(lanes, states), speed2(lanes)
    unit = spread(identity, 1, lanes)
    zero = 0
    call material%start_state(unit, zero, state)
    call strain_increment(strain, df)
    call material%advance_state(1.0_wp, unit, df, df, state, dissipated)
    call material%kirchhoff(df, state, tau, speed2)
    call material%equivalent_plastic_strain(state, ep)
  end subroutine strain_once

  subroutine test_j2_numbers()
    class(material_t), allocatable :: material
    real(wp), parameter :: strain(6) = [0.004_wp, -0.001_wp, -0.0005_wp, 0.001_wp, 0.0_wp, 0.0_wp]
    real(wp), parameter :: expected(6) = [588.538099_wp, 290.846364_wp, 320.615537_wp, 59.538347_wp, 0.0_wp, 0.0_wp]
    real(wp) :: tau(lanes, 6), ep(lanes), work(lanes), f(lanes, 9), state(lanes, states), zero(lanes, 6), b(lanes, 9), speed2(lanes)
    integer :: k
    call make_metal(160000.0_wp, 80000.0_wp, 300.0_wp, 1000.0_wp, material)
    call strain_once(material, spread(strain, 1, lanes), tau, ep, work)
    do k = 1, lanes
      call check(tau(k, :), expected, 5.1e-7_wp, "J2: stress") ! digits given
      call check(ep(k), 2.12411338e-3_wp, 5.1e-12_wp, "J2: plastic strain")
    end do
    call check(work(1), ep(1)*(300 + 1000*ep(1)/2), 1.0e-12_wp, "J2: mean flow stress times plastic strain")
    zero = 0
    call strain_increment(spread(strain, 1, lanes), f)
    call material%start_state(f, zero, state)
    call material%kirchhoff(f, state, tau, speed2)
    call check(tau(2, :), expected, 5.1e-7_wp, "J2: a strained start is returned at t = 0")
    call check(state(2, 1), 2.12411338e-3_wp, 5.1e-12_wp, "J2: and has flowed")
    ! b_e is exp(2 e) of the stress's own elastic strain, so one more step without motion changes nothing
    b = spread(identity, 1, lanes)
    call material%advance_state(1.0_wp, b, b, f, state, work)
    call material%kirchhoff(f, state, tau, speed2)
    call check(tau(2, :), expected, 5.1e-7_wp, "J2: rest after the return")
    call check(state(2, 1), 2.12411338e-3_wp, 5.1e-12_wp, "J2: rest does not flow")
  end subroutine test_j2_numbers

  !> (p, sqrt J2) of the stress in a lane
  pure subroutine meridian(tau, p, root)
    real(wp), intent(in) :: tau(6)
    real(wp), intent(out) :: p, root
    p = sum(tau(1:3))/3
    root = sqrt(sum((tau(1:3) - p)**2)/2 + sum(tau(4:6)**2))
  end subroutine meridian

  !> The strain with the elastic stress (p, sqrt J2) for a deviator in a direction that differs from lane to lane
  subroutine trial_of(bulk, shear, p, root, strain)
    real(wp), intent(in) :: bulk, shear, p, root
    real(wp), intent(out) :: strain(lanes, 6)
    integer :: k
    real(wp) :: angle
    do k = 1, lanes
      angle = 0.8_wp*k
      strain(k, 1:3) = root/(shear*sqrt(3.0_wp))*cos(angle)*[cos(angle), cos(angle + 2.0943951023931953_wp), &
        cos(angle - 2.0943951023931953_wp)] + p/(3*bulk)
      strain(k, 4:6) = root/(2*shear)*sin(angle)*[0.6_wp, 0.0_wp, 0.8_wp]
    end do
  end subroutine trial_of

  subroutine test_drucker_prager_numbers()
    class(material_t), allocatable :: material
    real(wp) :: strain(lanes, 6), tau(lanes, 6), ep(lanes), work(lanes), p, root
    integer :: k
    call make_soil(80.0_wp, 40.0_wp, 1.0_wp, 30.0_wp, 10.0_wp, "plane_strain", material)
    call trial_of(80.0_wp, 40.0_wp, -5.0_wp, 10.0_wp, strain)
    call strain_once(material, strain, tau, ep, work)
    do k = 1, lanes
      call meridian(tau(k, :), p, root)
      call check([p, root], [-7.00522167_wp, 4.19724993_wp], 5.1e-9_wp, "Drucker-Prager: cone") ! digits given
    end do
    call check(ep, spread((10 - 4.19724993_wp)/(40*sqrt(3.0_wp)), 1, lanes), 1.0e-9_wp, "Drucker-Prager: plastic strain")
    call check(work, spread((-7.00522167_wp)*(-5 + 7.00522167_wp)/80 + 4.19724993_wp*(10 - 4.19724993_wp)/40, 1, lanes), &
      1.0e-8_wp, "Drucker-Prager: plastic work")
    call trial_of(80.0_wp, 40.0_wp, 6.0_wp, 1.0_wp, strain)
    call strain_once(material, strain, tau, ep, work)
    do k = 1, lanes
      call meridian(tau(k, :), p, root)
      call check([p, root], [1.73205081_wp, 0.0_wp], 5.1e-9_wp, "Drucker-Prager: apex")
    end do
    call trial_of(80.0_wp, 40.0_wp, -5.0_wp, 3.0_wp, strain)
    call strain_once(material, strain, tau, ep, work)
    do k = 1, lanes
      call meridian(tau(k, :), p, root)
      call check([p, root], [-5.0_wp, 3.0_wp], 1.0e-13_wp, "Drucker-Prager: elastic inside the cone")
    end do
    call check_true(all(ep == 0) .and. all(work == 0), "Drucker-Prager: nothing flows inside the cone")
  end subroutine test_drucker_prager_numbers

  !> Perfect plasticity in uniaxial strain: load to 5 yield strains, unload, yield again in the other sense
  subroutine test_uniaxial_strain()
    class(material_t), allocatable :: material
    real(wp), parameter :: bulk = 160, shear = 80, yield = 3, first = yield/(2*shear)
    integer, parameter :: steps = 40
    real(wp) :: unit(lanes, 9), df(lanes, 9), zero(lanes, 6), state(lanes, states), work(lanes), de(lanes, 6), e, expected
    real(wp) :: dissipated, tau(lanes, 6), speed2(lanes)
    integer :: n
    call make_metal(bulk, shear, yield, 0.0_wp, material)
    unit = spread(identity, 1, lanes)
    zero = 0
    call material%start_state(unit, zero, state)
    e = 0
    dissipated = 0
    do n = 1, 2*steps
      de = 0
      de(:, 1) = 5*first/steps*merge(1, -1, n <= steps)
      e = e + de(1, 1)
      call strain_increment(de, df)
      call material%advance_state(1.0_wp, unit, df, unit, state, work)
      dissipated = dissipated + work(1)
      if (n <= steps) then
        expected = merge((bulk + 4*shear/3)*e, bulk*e + 2*yield/3, e <= first)
      else ! elastic for a reversal of 2 first
        expected = merge(bulk*e + 2*yield/3 - 4*shear/3*(5*first - e), bulk*e - 2*yield/3, e >= 3*first)
      end if
      call material%kirchhoff(unit, state, tau, speed2)
      call check(tau(5, 1), expected, 1.0e-12_wp, "uniaxial strain, perfect plasticity")
    end do
    ! plastic strain 2/3 of the strain beyond yield: 4 first on the way out, 3 first on the way back
    call check(state(5, 1), 7*first*2/3, 1.0e-13_wp, "uniaxial strain: plastic strain")
    call check(dissipated, yield*7*first*2/3, 1.0e-13_wp, "uniaxial strain: plastic work")
  end subroutine test_uniaxial_strain

  !> Linear hardening in uniaxial stress: s = sy + E H/(E + H) (e - sy/E), reached by prescribing the lateral strain
  subroutine test_uniaxial_stress()
    class(material_t), allocatable :: material
    real(wp), parameter :: bulk = 160, shear = 80, yield = 3, h = 40
    real(wp) :: unit(lanes, 9), df(lanes, 9), zero(lanes, 6), state(lanes, states), work(lanes), de(lanes, 6)
    real(wp) :: young, poisson, e, s, lateral, before, tau(lanes, 6), speed2(lanes)
    integer :: n
    call make_metal(bulk, shear, yield, h, material)
    young = 9*bulk*shear/(3*bulk + shear)
    poisson = (3*bulk - 2*shear)/(2*(3*bulk + shear))
    unit = spread(identity, 1, lanes)
    zero = 0
    call material%start_state(unit, zero, state)
    before = 0
    do n = 1, 20
      e = 5*yield/young*n/20
      s = min(young*e, yield + young*h/(young + h)*(e - yield/young))
      lateral = -poisson*s/young - (e - s/young)/2
      de = 0
      de(:, 1) = 5*yield/young/20
      de(:, 2:3) = lateral - before
      before = lateral
      call strain_increment(de, df)
      call material%advance_state(1.0_wp, unit, df, unit, state, work)
      call material%kirchhoff(unit, state, tau, speed2)
      call check(tau(3, :), [s, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 1.0e-12_wp, "uniaxial stress, linear hardening")
      call check(state(3, 1), e - s/young, 1.0e-13_wp, "uniaxial stress: plastic strain")
    end do
  end subroutine test_uniaxial_stress

  !> Newton's method in lanes against bisection, lanes from elastic to a strain of 1, weak to full hardening
  subroutine test_power_hardening()
    class(material_t), allocatable :: material
    type(material_options_t) :: options
    real(wp), parameter :: bulk = 160000, shear = 80000, yield = 300
    real(wp), parameter :: exponents(4) = [0.0_wp, 0.05_wp, 0.4_wp, 1.0_wp]
    real(wp), parameter :: strains(3) = [1.0e-4_wp, 2.0e-3_wp, 0.5_wp]
    real(wp) :: strain(lanes, 6), tau(lanes, 6), ep(lanes), work(lanes), q, g, low, high, flow
    integer :: i, j, k, bisection
    do i = 1, size(exponents)
      do j = 1, size(strains)
        options = material_options_t(model="hencky_von_mises", yield_stress=yield, hardening="power", &
          hardening_exponent=exponents(i), hardening_strain=strains(j))
        call make(options, bulk, shear, material)
        strain = 0
        strain(:, 4) = [(1.0e-3_wp*10.0_wp**(3*(k - 1)/7.0_wp), k=1, lanes)]
        call strain_once(material, strain, tau, ep, work)
        do k = 1, lanes
          q = sqrt(12.0_wp)*shear*strain(k, 4)
          low = 0
          high = q/(3*shear)
          do bisection = 1, 200
            g = (low + high)/2
            flow = yield*(1 + g/strains(j))**exponents(i)
            if (q - 3*shear*g > flow) low = g
            if (q - 3*shear*g <= flow) high = g
          end do
          if (q <= yield) g = 0
          ! the residual is met to some units in the last place of q, and q/(3 mu) is up to 1
          call check(ep(k), g, 3.0e-15_wp + 1.0e-14_wp*g, "power hardening: plastic strain")
          if (g > 0) call check(sqrt(3.0_wp)*tau(k, 4)/flow, 1.0_wp, 1.0e-11_wp, "power hardening: on the yield surface")
        end do
      end do
    end do
  end subroutine test_power_hardening

  !> Work done = stored + dissipated: to second order in the step on a path that turns, for metal and soil
  subroutine test_energy_balance()
    class(material_t), allocatable :: material
    real(wp) :: coarse(lanes), fine(lanes)
    call make_metal(160.0_wp, 80.0_wp, 3.0_wp, 40.0_wp, material)
    call imbalance(material, 50, coarse)
    call imbalance(material, 200, fine)
    call check(fine, spread(0.0_wp, 1, lanes), 2.0e-4_wp, "metal: work = stored + dissipated")
    call check_true(all(abs(fine) < abs(coarse)/3), "metal: the difference vanishes with the step")
    call make_soil(160.0_wp, 80.0_wp, 1.0_wp, 30.0_wp, 10.0_wp, "outer", material)
    call imbalance(material, 50, coarse)
    call imbalance(material, 200, fine)
    call check(fine, spread(0.0_wp, 1, lanes), 2.0e-2_wp, "soil: work = stored + dissipated") ! plastic work at the end stress
    call check_true(all(abs(fine) < abs(coarse)/3), "soil: the difference vanishes with the step")
  end subroutine test_energy_balance

  !> What the books miss on a path that turns
  subroutine imbalance(material, steps, difference)
    class(material_t), intent(in) :: material
    integer, intent(in) :: steps
    real(wp), intent(out) :: difference(lanes) !! relative to the work
    real(wp) :: unit(lanes, 9), df(lanes, 9), zero(lanes, 6), state(lanes, states), de(lanes, 6), tau(lanes, 6)
    real(wp) :: work(lanes), dissipated(lanes), now(lanes), energy(lanes), before(lanes, 6), speed2(lanes)
    integer :: k, n
    unit = spread(identity, 1, lanes)
    zero = 0
    call material%start_state(unit, zero, state)
    work = 0
    dissipated = 0
    do n = 1, steps
      do k = 1, lanes
        de(k, :) = 0.1_wp/steps*[-1.0_wp, 0.3_wp*cos(3.0_wp*n/steps), -0.4_wp, 0.1_wp*k, sin(4.0_wp*n/steps), 0.0_wp]
      end do
      call material%kirchhoff(unit, state, before, speed2)
      call strain_increment(de, df)
      call material%advance_state(1.0_wp, unit, df, unit, state, now)
      call material%kirchhoff(unit, state, tau, speed2)
      tau = (before + tau)/2
      work = work + sum(tau(:, 1:3)*de(:, 1:3), 2) + 2*sum(tau(:, 4:6)*de(:, 4:6), 2)
      dissipated = dissipated + now
      call check_true(all(now >= 0), "plastic work is never negative on this path")
    end do
    call material%stored_energy(unit, state, energy)
    difference = (work - energy - dissipated)/work
  end subroutine imbalance

  !> Where each cone must touch the Mohr-Coulomb surface k s1 - s3 = 2 c sqrt k
  subroutine test_cones_touch_mohr_coulomb()
    real(wp), parameter :: c = 2, phi = 35, k = (1 + sin(phi*acos(-1.0_wp)/180))/(1 - sin(phi*acos(-1.0_wp)/180))
    class(material_t), allocatable :: material
    real(wp) :: tau(lanes, 6), ep(lanes), work(lanes), strain(lanes, 6), p, root, middle, r
    integer :: lane
    call make_soil(80.0_wp, 40.0_wp, c, phi, 0.0_wp, "outer", material)
    strain = 0
    strain(:, 3) = [(-0.1_wp - 0.05_wp*lane, lane=1, lanes)]
    strain(:, 1) = -0.3_wp*strain(:, 3)
    strain(:, 2) = strain(:, 1)
    call strain_once(material, strain, tau, ep, work)
    call check_true(all(ep > 0), "triaxial compression yields")
    call check(k*tau(:, 1) - tau(:, 3), spread(2*c*sqrt(k), 1, lanes), 1.0e-11_wp, "outer cone: triaxial compression")
    call make_soil(80.0_wp, 40.0_wp, c, phi, 0.0_wp, "inner", material)
    strain(:, 1) = strain(:, 3)
    strain(:, 2) = strain(:, 3)
    strain(:, 3) = -strain(:, 3)
    call strain_once(material, strain, tau, ep, work)
    call check_true(all(ep > 0), "triaxial extension yields")
    call check(k*tau(:, 3) - tau(:, 1), spread(2*c*sqrt(k), 1, lanes), 1.0e-11_wp, "inner cone: triaxial extension")
    ! Plane strain: associated flow without strain along the middle axis, s2/(2 sqrt J2) + eta/3 = 0
    call make_soil(80.0_wp, 40.0_wp, c, phi, phi, "", material)
    select type (material)
    type is (drucker_prager_t)
      p = -3
      root = material%strength - material%eta*p
      middle = -2*material%eta*root/3
      r = sqrt(root**2 - 3*middle**2/4)
      call check(k*(p - middle/2 + r) - (p - middle/2 - r), 2*c*sqrt(k), 1.0e-12_wp, "default cone: plane strain")
    class default
      call check_true(.false., "the model is Drucker-Prager")
    end select
  end subroutine test_cones_touch_mohr_coulomb

  !> No friction: sqrt(J2) = c at any pressure, tension included
  subroutine test_frictionless_cone()
    class(material_t), allocatable :: material
    real(wp) :: strain(lanes, 6), tau(lanes, 6), ep(lanes), work(lanes), p, root, pressure
    integer :: k, n
    call make_soil(80.0_wp, 40.0_wp, 1.5_wp, 0.0_wp, 0.0_wp, "plane_strain", material)
    do n = -1, 1
      pressure = 7.0_wp*n
      call trial_of(80.0_wp, 40.0_wp, pressure, 4.0_wp, strain)
      call strain_once(material, strain, tau, ep, work)
      do k = 1, lanes
        call meridian(tau(k, :), p, root)
        call check([p, root], [pressure, 1.5_wp], 1.0e-13_wp, "frictionless cone")
      end do
    end do
  end subroutine test_frictionless_cone

  !> Sand bears no tension, and comes back to stress when pressed again
  subroutine test_cohesionless_tension()
    class(material_t), allocatable :: material
    real(wp) :: strain(lanes, 6), df(lanes, 9), unit(lanes, 9), state(lanes, states), zero(lanes, 6), work(lanes)
    real(wp) :: tau(lanes, 6), speed2(lanes)
    call make_soil(80.0_wp, 40.0_wp, 0.0_wp, 30.0_wp, 0.0_wp, "plane_strain", material)
    call trial_of(80.0_wp, 40.0_wp, 3.0_wp, 1.0_wp, strain)
    unit = spread(identity, 1, lanes)
    zero = 0
    call material%start_state(unit, zero, state)
    call strain_increment(strain, df)
    call material%advance_state(1.0_wp, unit, df, df, state, work)
    call material%kirchhoff(unit, state, tau, speed2)
    call check(reshape(tau, [6*lanes]), spread(0.0_wp, 1, 6*lanes), 1.0e-13_wp, "sand: no tension")
    call check(work, spread(0.0_wp, 1, lanes), 1.0e-14_wp, "sand: tearing it costs nothing")
    df = 0.99_wp*spread(identity, 1, lanes)
    call material%advance_state(1.0_wp, unit, df, df, state, work)
    call material%kirchhoff(unit, state, tau, speed2)
    call check(tau(:, 1), spread(240*log(0.99_wp), 1, lanes), 1.0e-12_wp, "sand: pressed again")
  end subroutine test_cohesionless_tension

  !> A given stress sets the elastic strain: inside the yield surface it is kept, outside it is returned
  subroutine test_starting_stress()
    class(material_t), allocatable :: material
    real(wp) :: f(lanes, 9), stress(lanes, 6), state(lanes, states), tau(lanes, 6), speed2(lanes), j, p, root
    integer :: k
    call make_soil(80.0e3_wp, 40.0e3_wp, 1.0_wp, 30.0_wp, 0.0_wp, "plane_strain", material)
    f = spread(1.1_wp*identity, 1, lanes)
    j = 1.331_wp
    do k = 1, lanes
      stress(k, :) = -real(k, wp)*[5.0_wp, 6.0_wp, 7.0_wp, 0.5_wp, -0.3_wp, 0.2_wp]
    end do
    call material%start_state(f, stress, state)
    call material%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes ! strains of 1e-4 in numbers near one: 12 digits
      call check(tau(k, :), j*stress(k, :), 1.0e-10_wp, "geostatic stress is kept")
    end do
    stress(:, 4) = 100
    call material%start_state(f, stress, state)
    call material%kirchhoff(f, state, tau, speed2)
    do k = 1, lanes
      call meridian(tau(k, :), p, root)
      call check(root, 3/sqrt(13.0_wp)*(1 - p/sqrt(3.0_wp)), 1.0e-9_wp, "a stress outside the cone is returned to it")
    end do
  end subroutine test_starting_stress

end program test_plastic
