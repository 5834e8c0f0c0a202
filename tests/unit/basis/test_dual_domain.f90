!> Weights of the dual domain method: equal to the two stages of the paper evaluated on a grid, and what every gradient must keep
program test_dual_domain
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: grid_t, make_grid
  use gimp_basis, only: weight_list_t
  use gimp_dual_domain, only: dual_ends, make_dual_list, smear_tents
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check
  implicit none(type, external)

  integer, parameter :: cells(3) = [5, 4, 3] !! few enough that every particle of the box sees a side
  integer, parameter :: n = 60 !! particles
  real(wp), parameter :: round_off = 2.0e-14_wp !! sums of 64 products of size 1
  integer :: dim

  call begin_suite("dual domain")
  do dim = 1, 3
    call test_identities(dim)
    call test_two_stages(dim, 1.0_wp)
    call test_two_stages(dim, 0.5_wp)
    call test_lanes(dim)
  end do
  call test_faces()
  call test_ends()
  call test_uniform_stress()
  call end_suite()

contains

  !> Particles anywhere in the box, some right on its sides and on nodes
  subroutine some_places(dim, x)
    integer, intent(in) :: dim
    real(wp), intent(out) :: x(3, n)
    integer :: k
    call random_seed_of(11)
    call random_number(x)
    do k = 1, 3
      x(k, :) = x(k, :)*cells(k)
    end do
    x(1, 1) = 0.0_wp
    x(dim, 2) = cells(dim)
    x(:, 3) = 2.0_wp
    x(dim + 1:, :) = 0.0_wp
  end subroutine some_places

  subroutine random_seed_of(number)
    integer, intent(in) :: number
    integer :: length
    call random_seed(size=length)
    call random_seed(put=spread(number, 1, length))
  end subroutine random_seed_of

  subroutine list_of(dim, x, strongest, list)
    integer, intent(in) :: dim
    real(wp), intent(in) :: x(3), strongest
    type(weight_list_t), intent(out) :: list
    real(wp) :: low(3), high(3)
    call dual_ends(make_grid(dim, [0.0d0, 0.0d0, 0.0d0], real(cells, kind(0.0d0)), 1.0d0), [0, 0, 0], low, high)
    call make_dual_list(dim, x(:dim), low, high, strongest, list)
  end subroutine list_of

  !> sum S = 1, sum G = 0, sum x_i S = x, sum x_i (x) G = I, at sides and on nodes, too; nothing goes beyond the box
  subroutine test_identities(dim)
    integer, intent(in) :: dim
    type(weight_list_t) :: list
    real(wp) :: x(3, n), place(3), one(3), first(3, 3)
    integer :: p, i, j
    call some_places(dim, x)
    do p = 1, n
      call list_of(dim, x(:, p), 0.7_wp, list)
      place = 0.0_wp
      first = 0.0_wp
      one = 0.0_wp
      do i = 1, list%n
        place = place + list%s(i)*list%node(:, i)
        one = one + list%g(:, i)
        do j = 1, 3
          first(j, :) = first(j, :) + list%node(j, i)*list%g(:, i)
        end do
        if (any(list%node(:dim, i) < 0 .or. list%node(:dim, i) > cells(:dim))) &
          call check(maxval(abs(list%g(:, i))), 0.0_wp, 0.0_wp, "no force goes beyond the box, "//text_of(dim)//"D")
      end do
      do j = 1, dim
        first(j, j) = first(j, j) - 1.0_wp
      end do
      call check(sum(list%s(:list%n)), 1.0_wp, round_off, "sum of weights, "//text_of(dim)//"D")
      call check(maxval(abs(one)), 0.0_wp, round_off, "sum of gradients, "//text_of(dim)//"D")
      call check(maxval(abs(place - x(:, p))), 0.0_wp, round_off, "linear fields, "//text_of(dim)//"D")
      call check(maxval(abs(first)), 0.0_wp, round_off, "gradients of linear fields, "//text_of(dim)//"D")
    end do
  end subroutine test_identities

  !> Nodal stresses first, then forces by Gbar; nodal velocity gradients first, then their interpolation: the same as by the list, and
  !> the power of the forces is that of the stresses
  subroutine test_two_stages(dim, strongest)
    integer, intent(in) :: dim
    real(wp), intent(in) :: strongest
    integer, parameter :: most = 6*5*4
    type(weight_list_t) :: list
    real(wp) :: x(3, n), volume(n), stress(3, 3, n), v(3, most), f(3, most), f_list(3, most), sigma(3, 3, most), h(3, 3, most)
    real(wp) :: gbar(3, most, most), own(3, most), tent(most), alpha, l_stages(3, 3), l_list(3, 3), power, given
    integer :: p, i, j, k, nodes
    call some_places(dim, x)
    nodes = product(cells(:dim) + 1)
    call random_number(volume)
    call random_number(stress)
    call random_number(v)
    gbar = 0.0_wp
    do j = 1, nodes
      do i = 1, nodes
        gbar(:, j, i) = mean_gradient(dim, place_of(dim, j), place_of(dim, i))
      end do
    end do
    sigma = 0.0_wp
    f = 0.0_wp
    f_list = 0.0_wp
    h = 0.0_wp
    do j = 1, nodes
      do i = 1, nodes
        do k = 1, 3
          h(:, k, j) = h(:, k, j) + v(:, i)*gbar(k, j, i)
        end do
      end do
    end do
    power = 0.0_wp
    do p = 1, n
      call tents_at(dim, x(:, p), nodes, tent, own, alpha)
      alpha = alpha*strongest
      l_stages = 0.0_wp
      do i = 1, nodes
        sigma(:, :, i) = sigma(:, :, i) + volume(p)*(1.0_wp - alpha)*tent(i)*stress(:, :, p)
        f(:, i) = f(:, i) - volume(p)*alpha*matmul(stress(:, :, p), own(:, i))
        do k = 1, 3
          l_stages(:, k) = l_stages(:, k) + alpha*v(:, i)*own(k, i) + (1.0_wp - alpha)*tent(i)*h(:, k, i)
        end do
      end do
      call list_of(dim, x(:, p), strongest, list)
      l_list = 0.0_wp
      do i = 1, list%n
        if (any(list%node(:dim, i) < 0 .or. list%node(:dim, i) > cells(:dim))) cycle
        j = number_of(dim, list%node(:, i))
        f_list(:, j) = f_list(:, j) - volume(p)*matmul(stress(:, :, p), list%g(:, i))
        do k = 1, 3
          l_list(:, k) = l_list(:, k) + v(:, j)*list%g(k, i)
        end do
      end do
      call check(maxval(abs(l_list - l_stages)), 0.0_wp, 1.0e-13_wp, "velocity gradient by nodes and by list, "//text_of(dim)//"D")
      power = power - volume(p)*sum(stress(:, :, p)*l_list)
    end do
    do i = 1, nodes ! f_i = -sum_j Sigma_j V_j Gbar_ji, and V_j is in Sigma_j once and before Gbar once
      do j = 1, nodes
        f(:, i) = f(:, i) - matmul(sigma(:, :, j), gbar(:, j, i))
      end do
    end do
    call check(maxval(abs(f(:, :nodes) - f_list(:, :nodes))), 0.0_wp, 1.0e-13_wp*n, "forces by nodal stresses and by list, "//text_of(dim)//"D")
    given = sum(f_list(:, :nodes)*v(:, :nodes))
    call check(given, power, 1.0e-13_wp*n, "power of forces and stresses, "//text_of(dim)//"D")
  end subroutine test_two_stages

  !> Tents of all nodes at a point, their gradients, and alpha/alpha_max; the last cell owns its upper face
  subroutine tents_at(dim, x, nodes, tent, own, alpha)
    integer, intent(in) :: dim, nodes
    real(wp), intent(in) :: x(3)
    real(wp), intent(out) :: tent(:), own(:, :), alpha
    real(wp) :: s(3), g(3), xi
    integer :: i, k, cell, node(3)
    tent = 0.0_wp
    own = 0.0_wp
    do i = 1, nodes
      node = place_of(dim, i)
      s = 1.0_wp
      g = 0.0_wp
      alpha = 1.0_wp
      do k = 1, dim
        cell = min(floor(x(k)), cells(k) - 1)
        xi = x(k) - cell
        alpha = alpha*4.0_wp*xi*(1.0_wp - xi)
        s(k) = max(0.0_wp, 1.0_wp - abs(x(k) - node(k)))
        if (node(k) == cell) g(k) = -1.0_wp
        if (node(k) == cell + 1) g(k) = 1.0_wp
      end do
      tent(i) = product(s)
      own(:, i) = [g(1)*s(2)*s(3), s(1)*g(2)*s(3), s(1)*s(2)*g(3)]
    end do
  end subroutine tents_at

  !> (1/V_j) int N_j grad N_i over the box, by two Gauss points an axis in every cell: exact
  function mean_gradient(dim, j, i) result(mean)
    integer, intent(in) :: dim, j(3), i(3)
    real(wp) :: mean(3)
    real(wp) :: value(3), slope(3), volume(3), y, weight
    integer :: k, c, g
    value = 1.0_wp
    slope = 0.0_wp
    volume = 1.0_wp
    do k = 1, dim
      value(k) = 0.0_wp
      volume(k) = 0.0_wp
      do c = 0, cells(k) - 1
        do g = -1, 1, 2
          y = c + 0.5_wp + g*0.5_wp/sqrt(3.0_wp)
          weight = 0.5_wp*max(0.0_wp, 1.0_wp - abs(y - j(k)))
          volume(k) = volume(k) + weight
          value(k) = value(k) + weight*max(0.0_wp, 1.0_wp - abs(y - i(k)))
          if (c == i(k)) slope(k) = slope(k) - weight
          if (c == i(k) - 1) slope(k) = slope(k) + weight
        end do
      end do
    end do
    mean = [slope(1)*value(2)*value(3), value(1)*slope(2)*value(3), value(1)*value(2)*slope(3)]/product(volume)
  end function mean_gradient

  pure integer function number_of(dim, node)
    integer, intent(in) :: dim, node(3)
    integer :: at(3)
    at = 0
    at(:dim) = node(:dim)
    number_of = 1 + at(1) + (cells(1) + 1)*(at(2) + (cells(2) + 1)*at(3))
  end function number_of

  pure function place_of(dim, number) result(node)
    integer, intent(in) :: dim, number
    integer :: node(3)
    node = [modulo(number - 1, cells(1) + 1), modulo((number - 1)/(cells(1) + 1), cells(2) + 1), &
            (number - 1)/((cells(1) + 1)*(cells(2) + 1))]
    node(dim + 1:) = 0
  end function place_of

  !> The rows of lanes are those of the list: compared through the gradients they make with alpha_max = 0
  subroutine test_lanes(dim)
    integer, intent(in) :: dim
    type(weight_list_t) :: list
    real(wp) :: x(3, n), tent(lanes, 2, dim), mean(lanes, 4, dim), slope(lanes, 4, dim), alpha(lanes), low(3), high(3), s(4, 3), expected
    integer :: inner(lanes, dim), l, p, k, i, at(3), axis
    call some_places(dim, x)
    call dual_ends(make_grid(dim, [0.0d0, 0.0d0, 0.0d0], real(cells, kind(0.0d0)), 1.0d0), [0, 0, 0], low, high)
    do p = 1, n - lanes + 1, lanes
      do l = 1, lanes
        do k = 1, dim
          inner(l, k) = floor(x(k, p + l - 1))
          tent(l, 2, k) = x(k, p + l - 1) - inner(l, k)
          tent(l, 1, k) = 1.0_wp - tent(l, 2, k)
        end do
      end do
      call smear_tents(dim, inner, tent, low, high, 0.5_wp, mean, slope, alpha)
      do l = 1, lanes
        call list_of(dim, x(:, p + l - 1), 0.0_wp, list)
        do axis = 1, dim
          s = 1.0_wp
          s(:, :dim) = mean(l, :, :)
          s(:, axis) = slope(l, :, axis)
          do i = 1, list%n
            at = 1
            at(:dim) = list%node(:dim, i) - inner(l, :) + 2
            expected = s(at(1), 1)*s(at(2), 2)*s(at(3), 3)
            call check(list%g(axis, i), expected, round_off, "rows of lanes, "//text_of(dim)//"D")
          end do
        end do
        call check(alpha(l), 0.5_wp*product([(4.0_wp*tent(l, 1, k)*tent(l, 2, k), k=1, dim)]), round_off, "alpha, "//text_of(dim)//"D")
      end do
    end do
  end subroutine test_lanes

  !> Gradients are continuous where tents jump
  subroutine test_faces()
    type(weight_list_t) :: below, above
    integer :: i
    real(wp) :: g(-5:9, 2)
    g = 0.0_wp
    call list_of(1, [2.0_wp - 1.0e-9_wp, 0.0_wp, 0.0_wp], 1.0_wp, below)
    call list_of(1, [2.0_wp + 1.0e-9_wp, 0.0_wp, 0.0_wp], 1.0_wp, above)
    do i = 1, 4
      g(below%node(1, i), 1) = below%g(1, i)
      g(above%node(1, i), 2) = above%g(1, i)
    end do
    call check(maxval(abs(g(:, 1) - g(:, 2))), 0.0_wp, 2.0e-8_wp, "gradients do not jump on a face") ! slopes up to 4 there
  end subroutine test_faces

  !> Periodic and symmetric sides are none
  subroutine test_ends()
    type(grid_t) :: grid
    real(wp) :: low(3), high(3)
    grid = make_grid(2, [0.0d0, 0.0d0], [20.0d0, 20.0d0], 1.0d0)
    grid%periodic(1) = .true.
    grid%mirror_low(2) = .true.
    call dual_ends(grid, [1, 1, 0], low, high)
    call check(high(2), 12.0_wp, 0.0_wp, "a side seen from a block")
    call check(min(high(1), -low(1), -low(2)), 1.0e6_wp, 0.0_wp, "sides that images continue")
  end subroutine test_ends

  !> A stretched line of particles under uniform stress: force on inner nodes by particles that no longer tile the cells. Largest force
  !> as an independent program found it (alpha_max = 1), of sigma, for 1 to 4 particles a cell, on a line that begins at another place of
  !> its cell: over all such places the largest force varies by a fifth, here it is the largest of all
  subroutine test_uniform_stress()
    real(wp), parameter :: expected(4) = [8.9e-2_wp, 2.0e-2_wp, 3.7e-3_wp, 6.1e-3_wp]
    real(wp), parameter :: stretch = 1.1_wp
    integer, parameter :: length = 40
    integer, parameter :: places = 40
    type(weight_list_t) :: list
    real(wp) :: f(-5:2*length), low(3), high(3), x, largest
    integer :: ppc, p, i, place
    low = -1.0e6_wp
    high = 1.0e6_wp
    do ppc = 1, 4
      largest = 0.0_wp
      do place = 0, places - 1
        f = 0.0_wp
        do p = 1, length*ppc
          x = stretch*(p - 0.5_wp)/ppc + real(place, wp)/places
          call make_dual_list(1, [x], low, high, 1.0_wp, list)
          do i = 1, list%n
            f(list%node(1, i)) = f(list%node(1, i)) - stretch/ppc*list%g(1, i)
          end do
        end do
        largest = max(largest, maxval(abs(f(5:int(stretch*length) - 4))))
      end do
      call check(largest, expected(ppc), 0.2_wp*expected(ppc), "crossing error with "//text_of(ppc)//" particles a cell")
    end do
  end subroutine test_uniform_stress

end program test_dual_domain
