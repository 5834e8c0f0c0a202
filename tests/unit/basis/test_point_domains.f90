!> Domains sampled at points: the four conditions of every weight list, their closed forms, and how long diagonals are shortened
program test_point_domains
  use gimp_kinds, only: wp, lanes
  use gimp_basis, only: weight_list_t, axis_weights
  use gimp_point_domains, only: point_rule_t, corner_rule, volume_rule, surface_rule, simpson_rule, make_point_list, half_edges, &
    limit_edges, place_points_1d, place_points_2d, place_points_3d
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer :: seed = 99, dim, n

  call begin_suite("point domains")
  do dim = 1, 3
    call test_conditions(dim, corner_rule(dim), "CPDI")
    call test_conditions(dim, simpson_rule(dim), "Simpson")
    do n = 1, 4
      call test_conditions(dim, volume_rule(dim, n), "volume "//text_of(n))
      call test_conditions(dim, surface_rule(dim, n), "surface "//text_of(n))
    end do
  end do
  call test_corner_weights()
  call test_quadrature(1, 0.18_wp, 0.12_wp)
  call test_quadrature(2, 0.030_wp, 0.020_wp)
  call test_quadrature(3, 0.013_wp, 0.014_wp)
  call test_quadrature(4, 0.009_wp, 0.009_wp)
  call test_limit()
  call end_suite()

contains

  !> Reproducible numbers in (-1, 1)
  real(wp) function random()
    seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
    random = 2*(seed/2147483647.0_wp) - 1
  end function random

  subroutine list_of(dim, rule, x, r, list)
    integer, intent(in) :: dim
    type(point_rule_t), intent(in) :: rule
    real(wp), intent(in) :: x(lanes, dim), r(lanes, dim*dim)
    type(weight_list_t), intent(inout) :: list
    real(wp) :: at(lanes, dim, rule%n), by(lanes, dim, rule%n), share(lanes, rule%n)
    select case (dim)
    case (1); call place_points_1d(rule%n, rule%c, rule%w, rule%q, x, r, at, share, by)
    case (2); call place_points_2d(rule%n, rule%c, rule%w, rule%q, x, r, at, share, by)
    case (3); call place_points_3d(rule%n, rule%c, rule%w, rule%q, x, r, at, share, by)
    end select
    call make_point_list(dim, rule%n, rule%by_gradient, at(1, :, :), share(1, :), by(1, :, :), list)
  end subroutine list_of

  !> sum S = 1, sum G = 0, sum x_i S = x, sum x_i (x) G = I for sheared, turned, flat and tiny domains. Gradients of a flat domain are
  !> of the size of its shortest edge, 1/0.002: 1e-11 leaves room for 500 epsilon times 30 places
  subroutine test_conditions(dim, rule, name)
    integer, intent(in) :: dim
    type(point_rule_t), intent(in) :: rule
    character(len=*), intent(in) :: name
    type(weight_list_t) :: list
    real(wp) :: x(lanes, dim), r(lanes, dim*dim), f(lanes, 9), half(lanes, 3), worst(4), moment(dim), unit(dim, dim)
    integer :: trial, i, j, k
    worst = 0.0_wp
    half = 0.25_wp
    do trial = 1, 200
      f = 0.0_wp
      do i = 1, dim
        do j = 1, dim
          f(:, 3*(i - 1) + j) = merge(1.0_wp, 0.0_wp, i == j) + 0.4_wp*random()
        end do
        x(:, i) = 5*random()
        if (modulo(trial, 10) == 0) x(:, i) = anint(x(:, i)) ! on a node
      end do
      half(:, 1) = merge(0.002_wp, 0.25_wp, modulo(trial, 7) == 0) ! flat
      call half_edges(dim, f, half, r)
      if (dim == 2 .and. modulo(trial, 5) == 0) r(1, :) = [0.0_wp, 0.25_wp, -0.25_wp, 0.0_wp] ! a quarter turn
      call list_of(dim, rule, x, r, list)
      worst(1) = max(worst(1), abs(sum(list%s(:list%n)) - 1.0_wp))
      do k = 1, dim
        worst(2) = max(worst(2), abs(sum(list%g(k, :list%n))))
        moment(k) = sum(list%node(k, :list%n)*list%s(:list%n)) - x(1, k)
        do j = 1, dim
          unit(k, j) = sum(list%node(k, :list%n)*list%g(j, :list%n)) - merge(1.0_wp, 0.0_wp, k == j)
        end do
      end do
      worst(3) = max(worst(3), maxval(abs(moment)))
      worst(4) = max(worst(4), maxval(abs(unit)))
    end do
    call check(worst, [0.0_wp, 0.0_wp, 0.0_wp, 0.0_wp], 1.0e-11_wp, name//", "//text_of(dim)//"D: conditions of a weight list")
  end subroutine test_conditions

  !> A square CPDI domain around a node: the four corners lie half-way in the cells around, by hand
  subroutine test_corner_weights()
    type(weight_list_t) :: list
    real(wp) :: x(lanes, 2), r(lanes, 4)
    integer :: i
    x = 3.0_wp
    r = 0.0_wp
    r(:, 1) = 0.5_wp
    r(:, 4) = 0.5_wp
    call list_of(2, corner_rule(2), x, r, list)
    call check(list%n, 9, "corners in four cells touch nine nodes")
    do i = 1, list%n
      associate (node => list%node(:2, i) - 3)
        call check(list%s(i), 0.25_wp/2**count(node /= 0), 1.0e-15_wp, "corner weights by hand")
        call check(list%g(1:2, i), 0.5_wp*node*[merge(0.5_wp, 1.0_wp, node(2) /= 0), merge(0.5_wp, 1.0_wp, node(1) /= 0)]*0.5_wp, &
                   1.0e-15_wp, "corner gradients by hand")
      end associate
    end do
  end subroutine test_corner_weights

  !> Gauss points in a box of half length 1/4 against the exact integrals: worst errors over 150 places of the weights and of the surface
  !> form's gradients, as the reference measured them (its places were others: three tenths more are allowed), and they are no better
  subroutine test_quadrature(n, weight, gradient)
    integer, intent(in) :: n
    real(wp), intent(in) :: weight, gradient
    type(weight_list_t) :: list
    real(wp) :: x(lanes, 2), r(lanes, 4), s(6, 2), g(6, 2), worst(2)
    integer :: trial, i, k, first(2), m(2)
    worst = 0.0_wp
    r = 0.0_wp
    r(:, 1) = 0.25_wp
    r(:, 4) = 0.25_wp
    do trial = 1, 150
      x(:, 1) = random()
      x(:, 2) = random()
      do k = 1, 2
        call axis_weights(x(1, k), 0.25_wp, first(k), m(k), s(:, k), g(:, k))
      end do
      call list_of(2, surface_rule(2, n), x, r, list)
      do i = 1, list%n
        associate (at => list%node(:2, i) - first + 1)
          if (any(at < 1 .or. at > m)) cycle
          worst(1) = max(worst(1), abs(list%s(i) - s(at(1), 1)*s(at(2), 2)))
          worst(2) = max(worst(2), maxval(abs(list%g(:2, i) - [g(at(1), 1)*s(at(2), 2), s(at(1), 1)*g(at(2), 2)])))
        end associate
      end do
    end do
    call check_true(worst(1) < 1.3_wp*weight .and. worst(1) > 0.5_wp*weight, &
                    "weights of "//text_of(n)//" Gauss points: error "//text_of(worst(1)))
    call check_true(worst(2) < 1.3_wp*gradient .and. worst(2) > 0.5_wp*gradient, &
                    "gradients from "//text_of(n)//" points on faces: error "//text_of(worst(2)))
  end subroutine test_quadrature

  !> Long half diagonals get the length asked for and keep their direction; short domains are left alone
  subroutine test_limit()
    real(wp) :: r(lanes, 3, 3), before(lanes, 3, 3), now(3), old(3)
    integer :: dim, clamped, l, a, k
    do dim = 1, 3
      do k = 1, 3
        do a = 1, 3
          do l = 1, lanes
            r(l, a, k) = merge(0.4_wp, 0.0_wp, a == k) + 0.1_wp*random()
          end do
        end do
      end do
      r(1, 1, 1) = 3.0_wp
      before = r
      clamped = 0
      call limit_some(dim, r, clamped)
      call check(clamped, 1, "one domain is too long, "//text_of(dim)//"D")
      call check_true(all(r(2:, :, :) == before(2:, :, :)), "the others are left alone")
      now = 0.0_wp
      old = 0.0_wp
      do k = 1, dim
        now(:dim) = now(:dim) + r(1, :dim, k)
        old(:dim) = old(:dim) + before(1, :dim, k)
      end do
      if (dim < 3) then
        call check(sqrt(sum(now**2)), 1.2_wp, 1.0e-14_wp, "the half diagonal has the length asked for")
        call check(now, old*(1.2_wp/sqrt(sum(old**2))), 1.0e-14_wp, "and its direction")
      else ! the four diagonals of three edges depend on each other
        call check_true(sqrt(sum(now**2)) < 1.2_wp + 1.0e-14_wp .and. sqrt(sum(now**2)) > 1.1_wp, "the half diagonal is short enough")
        call check_true(dot_product(now, old) > 0.999_wp*sqrt(sum(now**2)*sum(old**2)), "and keeps its direction but for little")
      end if
    end do
  end subroutine test_limit

  subroutine limit_some(dim, r, clamped)
    integer, intent(in) :: dim
    real(wp), intent(inout) :: r(lanes, 3, 3)
    integer, intent(inout) :: clamped
    real(wp) :: part(lanes, dim, dim)
    part = r(:, :dim, :dim)
    call limit_edges(dim, 1.2_wp, part, clamped)
    r(:, :dim, :dim) = part
  end subroutine limit_some

end program test_point_domains
