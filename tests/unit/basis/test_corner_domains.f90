!> Domains whose corners move with the grid: the conditions of every weight list, closed forms against quadrature with more points,
!> corners that move on a raster, and which domains have collapsed
program test_corner_domains
  use gimp_kinds, only: wp, dp, lanes
  use gimp_basis, only: weight_list_t
  use gimp_point_domains, only: make_point_list
  use gimp_corner_domains, only: carried_box, carried_simplex, corners_of, on_raster, move_corners, box_corners, long_lanes, draw_in, &
    least_share, place_corners_1d, place_corners_2d, place_corners_3d, least_jacobian_1d, least_jacobian_2d, least_jacobian_3d
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  integer :: seed = 7, dim

  call begin_suite("corner domains")
  do dim = 1, 3
    call test_conditions(dim, carried_box)
    call test_parallelepiped(dim)
    call test_collapse(dim, carried_box)
    if (dim == 1) cycle
    call test_conditions(dim, carried_simplex)
    call test_quadrature(dim)
    call test_collapse(dim, carried_simplex)
  end do
  call test_raster()
  call test_long()
  call end_suite()

contains

  !> Reproducible numbers in (-1, 1)
  real(wp) function random()
    seed = modulo(16807*modulo(seed, 127773) - 2836*(seed/127773), 2147483647)
    random = 2*(seed/2147483647.0_wp) - 1
  end function random

  subroutine place(dim, carried, corner, share, by, volume, least)
    integer, intent(in) :: dim, carried
    real(wp), intent(in) :: corner(:, :, :)
    real(wp), intent(out) :: share(:, :), by(:, :, :), volume(lanes), least(lanes)
    real(wp) :: at(lanes, dim, size(corner, 3))
    integer :: n
    n = size(corner, 3)
    select case (dim)
    case (1)
      call place_corners_1d(carried, n, corner, at, share, by, volume)
      call least_jacobian_1d(carried, n, corner, least)
    case (2)
      call place_corners_2d(carried, n, corner, at, share, by, volume)
      call least_jacobian_2d(carried, n, corner, least)
    case (3)
      call place_corners_3d(carried, n, corner, at, share, by, volume)
      call least_jacobian_3d(carried, n, corner, least)
    end select
    call check_true(all(at == corner), "points are the corners")
  end subroutine place

  !> Random domains of one shape, all lanes different; `flat` squeezes one axis
  subroutine random_domains(dim, carried, noise, flat, corner)
    integer, intent(in) :: dim, carried
    real(wp), intent(in) :: noise, flat
    real(wp), allocatable, intent(out) :: corner(:, :, :)
    real(wp) :: x(lanes, dim), r(lanes, dim, dim)
    integer :: a, k, l
    allocate (corner(lanes, dim, corners_of(carried, dim)))
    r = 0.0_wp
    do l = 1, lanes
      do k = 1, dim
        x(l, k) = 5*random()
        r(l, k, k) = 0.4_wp
      end do
    end do
    if (carried == carried_box) then
      call box_corners(dim, x, r, corner)
    else
      do a = 1, dim + 1
        corner(:, :, a) = x - 0.4_wp
        if (a > 1) corner(:, a - 1, a) = corner(:, a - 1, a) + 0.8_wp
      end do
    end if
    do a = 1, size(corner, 3)
      do l = 1, lanes
        do k = 1, dim
          corner(l, k, a) = corner(l, k, a) + noise*random()
        end do
        corner(l, 1, a) = x(l, 1) + flat*(corner(l, 1, a) - x(l, 1))
      end do
    end do
  end subroutine random_domains

  !> sum S = 1, sum G = 0, sum x_i S = sum w x_a, sum x_i (x) G = I, for distorted, flat and needle-like domains. Gradients of flat
  !> ones are of the size of their shortest edge, 1/(0.8*0.005): 1e-11 leaves room for 250 epsilon times 60 places
  subroutine test_conditions(dim, carried)
    integer, intent(in) :: dim, carried
    type(weight_list_t) :: list
    real(wp), allocatable :: corner(:, :, :), share(:, :), by(:, :, :)
    real(wp) :: volume(lanes), least(lanes), worst(4), unit(dim, dim), center(dim)
    integer :: trial, i, j, k, l
    worst = 0.0_wp
    do trial = 1, 60
      call random_domains(dim, carried, 0.12_wp, merge(0.005_wp, 1.0_wp, modulo(trial, 5) == 0), corner)
      if (modulo(trial, 7) == 0) corner = anint(4*corner)/4 ! corners on nodes and faces
      allocate (share(lanes, size(corner, 3)), by(lanes, dim, size(corner, 3)))
      call place(dim, carried, corner, share, by, volume, least)
      do l = 1, lanes
        if (volume(l) < 1.0e-3_wp*0.8_wp**dim) cycle ! rounded to nothing
        call make_point_list(dim, size(corner, 3), .false., corner(l, :, :), share(l, :), by(l, :, :), list)
        center = matmul(corner(l, :, :), share(l, :))
        worst(1) = max(worst(1), abs(sum(list%s(:list%n)) - 1.0_wp))
        do k = 1, dim
          worst(2) = max(worst(2), abs(sum(list%g(k, :list%n))))
          worst(3) = max(worst(3), abs(sum(list%node(k, :list%n)*list%s(:list%n)) - center(k)))
          do j = 1, dim
            unit(j, k) = sum(list%node(j, :list%n)*list%g(k, :list%n)) - merge(1.0_wp, 0.0_wp, j == k)
          end do
        end do
        worst(4) = max(worst(4), maxval(abs(unit)))
      end do
      deallocate (share, by)
    end do
    do i = 1, 4
      call check(worst(i), 0.0_wp, 1.0e-11_wp, text_of(dim)//"D, kind "//text_of(carried)//", condition "//text_of(i))
    end do
  end subroutine test_conditions

  !> Parallelepipeds have equal weights, and gradients sum_k s_k r^k/2^dim by the dual vectors of their half edges
  subroutine test_parallelepiped(dim)
    integer, intent(in) :: dim
    real(wp) :: x(lanes, dim), r(lanes, dim, dim), corner(lanes, dim, 2**dim), share(lanes, 2**dim), by(lanes, dim, 2**dim), &
                volume(lanes), least(lanes), unit(dim, dim)
    integer :: a, k, l
    do l = 1, lanes
      do k = 1, dim
        x(l, k) = 5*random()
        r(l, :, k) = 0.1_wp*[(random(), a=1, dim)]
        r(l, k, k) = r(l, k, k) + 0.4_wp
      end do
    end do
    call box_corners(dim, x, r, corner)
    call place(dim, carried_box, corner, share, by, volume, least)
    call check(maxval(abs(share - 0.5_wp**dim)), 0.0_wp, 1.0e-14_wp, "equal weights, "//text_of(dim)//"D")
    call check(maxval(abs(least - volume)), 0.0_wp, 1.0e-14_wp, "one determinant everywhere, "//text_of(dim)//"D")
    do l = 1, lanes
      unit = 0.0_wp
      do a = 1, 2**dim
        do k = 1, dim
          unit(:, k) = unit(:, k) + merge(1.0_wp, -1.0_wp, btest(a - 1, k - 1))*by(l, :, a)
        end do
      end do
      unit = matmul(transpose(r(l, :, :)), unit) ! r_j . r^k = 1 if j = k
      do k = 1, dim
        unit(k, k) = unit(k, k) - 1.0_wp
      end do
      call check(maxval(abs(unit)), 0.0_wp, 1.0e-13_wp, "gradients by dual vectors, "//text_of(dim)//"D")
    end do
  end subroutine test_parallelepiped

  !> w, g and V of quadrilaterals and hexahedra by 4 Gauss points an axis: exact, so only round-off lies between
  subroutine test_quadrature(dim)
    integer, intent(in) :: dim
    real(wp), parameter :: inner = sqrt((3.0_wp - 2.0_wp*sqrt(1.2_wp))/7.0_wp), outer = sqrt((3.0_wp + 2.0_wp*sqrt(1.2_wp))/7.0_wp)
    real(wp), parameter :: place_of(4) = [-outer, -inner, inner, outer]
    real(wp), parameter :: more = (18.0_wp + sqrt(30.0_wp))/36.0_wp, less = (18.0_wp - sqrt(30.0_wp))/36.0_wp
    real(wp), parameter :: weight(4) = [less, more, more, less]
    real(wp), allocatable :: corner(:, :, :)
    real(wp) :: share(lanes, 2**dim), by(lanes, dim, 2**dim), volume(lanes), least(lanes)
    real(wp) :: w(2**dim), g(3, 2**dim), v, m(2**dim), slope(3, 2**dim), jacobian(3, 3), area(3, 3), xi(3), s(3), det, q
    integer :: l, i, k, a, at(3)
    call random_domains(dim, carried_box, 0.15_wp, 1.0_wp, corner)
    call place(dim, carried_box, corner, share, by, volume, least)
    do l = 1, lanes
      w = 0.0_wp
      g = 0.0_wp
      v = 0.0_wp
      do i = 0, 4**dim - 1
        at = 1 + modulo([i, i/4, i/16], 4)
        xi = 0.0_wp
        xi(:dim) = place_of(at(:dim))
        q = product(weight(at(:dim)))
        do a = 1, 2**dim
          s = [(merge(1.0_wp, -1.0_wp, btest(a - 1, k - 1)), k=1, 3)]
          m(a) = product(0.5_wp*(1.0_wp + s(:dim)*xi(:dim)))
          do k = 1, dim
            slope(k, a) = 0.5_wp*s(k)*product(0.5_wp*(1.0_wp + s(:dim)*xi(:dim)), mask=[1, 2, 3] /= k .and. [1, 2, 3] <= dim)
          end do
        end do
        jacobian = 0.0_wp
        jacobian(3, 3) = 1.0_wp
        do k = 1, dim
          jacobian(:dim, k) = matmul(corner(l, :, :), slope(k, :)) ! dx/dxi_k
        end do
        do k = 1, 3
          area(:, k) = cross(jacobian(:, modulo(k, 3) + 1), jacobian(:, modulo(k + 1, 3) + 1))
        end do
        det = dot_product(jacobian(:, 1), area(:, 1))
        v = v + q*det
        w = w + q*det*m
        do k = 1, dim
          g = g + q*spread(area(:, k), 2, 2**dim)*spread(slope(k, :), 1, 3)
        end do
      end do
      call check(volume(l), v, 1.0e-14_wp, "volume, "//text_of(dim)//"D")
      call check(maxval(abs(share(l, :) - w/v)), 0.0_wp, 1.0e-14_wp, "weights, "//text_of(dim)//"D")
      call check(maxval(abs(by(l, :, :) - g(:dim, :)/v)), 0.0_wp, 1.0e-13_wp, "gradients, "//text_of(dim)//"D")
    end do
  end subroutine test_quadrature

  pure function cross(a, b) result(c)
    real(wp), intent(in) :: a(3), b(3)
    real(wp) :: c(3)
    c = [a(2)*b(3) - a(3)*b(2), a(3)*b(1) - a(1)*b(3), a(1)*b(2) - a(2)*b(1)]
  end function cross

  !> One corner pushed towards the others: the least determinant falls with it through the bound and below zero
  subroutine test_collapse(dim, carried)
    integer, intent(in) :: dim, carried
    real(wp), allocatable :: corner(:, :, :), share(:, :), by(:, :, :)
    real(wp) :: volume(lanes), least(lanes), last, sound
    integer :: step, n
    call random_domains(dim, carried, 0.0_wp, 1.0_wp, corner)
    n = size(corner, 3)
    allocate (share(lanes, n), by(lanes, dim, n))
    last = huge(1.0_wp)
    do step = 0, 10
      if (step > 0 .and. carried == carried_box) corner(:, :, n) = corner(:, :, n) - 0.1_wp
      if (step > 0 .and. carried == carried_simplex) corner(:, dim, n) = corner(:, dim, n) - 0.1_wp
      call place(dim, carried, corner, share, by, volume, least)
      if (step == 0) then
        call check(least(1), volume(1), 1.0e-14_wp, "a sound domain")
        sound = volume(1)
      end if
      call check_true(least(1) <= last, "the least determinant falls")
      last = least(1)
      if (step == 2) call check_true(least(1) > least_share*sound, "not yet")
    end do
    call check_true(least(1) < least_share*sound, "at the end it has collapsed, "//text_of(dim)//"D")
  end subroutine test_collapse

  !> Copies of a corner counted from two blocks move alike: their difference stays a whole number
  subroutine test_raster()
    real(wp) :: here(lanes, 1), there(lanes, 1), v(lanes, 1)
    integer :: step, l
    do l = 1, lanes
      here(l, 1) = on_raster(real(70*random(), dp))
    end do
    there = here - 64.0_wp
    do step = 1, 1000
      do l = 1, lanes
        v(l, 1) = random()
      end do
      call move_corners(1, 0.003_wp, v, here)
      call move_corners(1, 0.003_wp, v, there)
    end do
    call check_true(all(here - 64.0_wp == there), "no bit is lost in another block")
    call check(real(on_raster(1.0_dp/3.0_dp), dp)*2.0_dp**44, anint(2.0_dp**44/3.0_dp), 0.0_wp, "multiples of 2^-44")
    call check(on_raster(1000.1_dp), 1000.1_wp, 0.0_wp, "far from the origin doubles are coarser than that")
  end subroutine test_raster

  subroutine test_long()
    real(wp), allocatable :: corner(:, :, :)
    real(wp) :: x(lanes, 2), one(2, 4)
    logical :: long(lanes)
    integer :: clamped
    call random_domains(2, carried_box, 0.0_wp, 1.0_wp, corner)
    x = sum(corner, dim=3)/4
    corner(3, :, 2) = x(3, :) + [1.2_wp, -0.9_wp] ! 1.5 cells away
    call long_lanes(2, 4, 1.4_wp, x, corner, long)
    call check_true(long(3) .and. count(long) == 1, "one has a far corner")
    call long_lanes(2, 4, 1.6_wp, x, corner, long)
    call check_true(.not. any(long), "not farther than that")
    clamped = 0
    one = corner(3, :, :)
    call draw_in(2, 4, 0.75_wp, x(3, :), one, clamped)
    call check(maxval(abs(one - spread(x(3, :), 2, 4) - 0.5_wp*(corner(3, :, :) - spread(x(3, :), 2, 4)))), 0.0_wp, 1.0e-14_wp, "drawn in to a half")
    call draw_in(2, 4, 0.76_wp, x(3, :), one, clamped)
    call check(clamped, 1, "once")
  end subroutine test_long

end program test_corner_domains
