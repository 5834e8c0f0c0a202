!> The fast kernels equal the weight lists they stand for, and scatter is the transpose of gather
program test_kernels
  use gimp_kinds, only: wp, lanes
  use gimp_grid, only: nf => fields_per_node
  use gimp_kernels, only: weights_2, weights_3, to_lanes, to_fields, row_1d, row_2d, row_3d, rows_3d, &
    gather_1d_2, gather_1d_3, gather_2d_2, gather_2d_3, gather_3d_2, gather_3d_3, &
    gather_value_1d_2, gather_value_1d_3, gather_value_2d_2, gather_value_2d_3, gather_value_3d_2, gather_value_3d_3, &
    scatter_1d_2, scatter_1d_3, scatter_2d_2, scatter_2d_3, scatter_3d_2, scatter_3d_3, &
    scatter_value_1d_2, scatter_value_1d_3, scatter_value_2d_2, scatter_value_2d_3, scatter_value_3d_2, scatter_value_3d_3
  use gimp_basis, only: weight_list_t, make_weight_list
  use gimp_engine_fixture, only: random_reals
  use gimp_text, only: text_of
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)

  real(wp), parameter :: round_off = epsilon(1.0_wp)
  !> Sums of up to 27 products of numbers below one, in another order; slopes of tents and narrow domains are at most 1 but the
  !> list form loses epsilon/l by cancellation, l >= 0.05 here
  real(wp), parameter :: tolerance = 200*round_off
  integer :: seed = 31, dim

  call begin_suite("kernels")
  do dim = 1, 3
    call test_against_list(dim, 2)
    call test_against_list(dim, 3)
  end do
  call test_faces_of_cells()
  call test_turning()
  call end_suite()

contains

  !> One particle per lane near the corner of a small grid of 5 nodes an axis: gather and scatter, with and without gradients
  subroutine test_against_list(dim, width)
    integer, intent(in) :: dim, width
    type(weight_list_t) :: list
    real(wp) :: x(lanes, 3), half(lanes, 3), w(lanes, 3, 3), d(lanes, 3, 3), u(6)
    real(wp) :: g(nf, 0:4, 0:4, 0:4), got(nf, lanes, 4), expected(nf, 4), a(nf, lanes, 4), to(nf, 0:4, 0:4, 0:4)
    real(wp) :: all_to(nf, 0:4, 0:4, 0:4), worst(5), one, other, numbers(nf*125)
    integer :: first(lanes, 3), trial, l, i, k, node(3)
    character(len=:), allocatable :: which
    which = ", "//text_of(dim)//"D, "//text_of(width)//" nodes"
    worst = 0.0_wp
    do trial = 1, 50
      call random_reals(seed, numbers)
      g = reshape(numbers, shape(g))
      do l = 1, lanes
        call random_reals(seed, u)
        x(l, :) = 1.6_wp + 0.8_wp*u(:3)
        half(l, :) = merge(0.275_wp + 0.225_wp*u(4:6), 0.0_wp, width == 3)
        if (trial == 1 .and. width == 3) half(l, :) = 0.5_wp
      end do
      first = 0
      w = 0.0_wp
      d = 0.0_wp
      call fast_weights(dim, width, x, half, first, w, d)
      call random_reals(seed, numbers(:size(a)))
      a = reshape(numbers(:size(a)), shape(a))
      do l = 1, lanes
        call make_weight_list(dim, x(l, :), half(l, :), list)
        expected = 0.0_wp
        to = 0.0_wp
        do i = 1, list%n
          node = list%node(:, i)
          expected(:, 1) = expected(:, 1) + list%s(i)*g(:, node(1), node(2), node(3))
          to(:, node(1), node(2), node(3)) = to(:, node(1), node(2), node(3)) + list%s(i)*a(:, l, 1)
          do k = 1, dim
            expected(:, 1 + k) = expected(:, 1 + k) + list%g(k, i)*g(:, node(1), node(2), node(3))
          end do
        end do
        call fast_gather(dim, width, first(l, :), g, w, d, l, .true., got)
        worst(1) = max(worst(1), maxval(abs(got(:, l, :dim + 1) - expected(:, :dim + 1))))
        one = sum(a(:, l, :dim + 1)*got(:, l, :dim + 1))
        got = huge(1.0_wp)
        call fast_gather(dim, width, first(l, :), g, w, d, l, .false., got)
        worst(2) = max(worst(2), maxval(abs(got(:, l, 1) - expected(:, 1))))
        all_to = 1.0_wp ! scatter adds to what is there
        call fast_scatter(dim, width, first(l, :), all_to, w, d, l, .false., a)
        worst(3) = max(worst(3), maxval(abs(all_to - 1.0_wp - to)))
        do i = 1, list%n
          node = list%node(:, i)
          do k = 1, dim
            to(:, node(1), node(2), node(3)) = to(:, node(1), node(2), node(3)) + list%g(k, i)*a(:, l, 1 + k)
          end do
        end do
        all_to = 0.0_wp
        call fast_scatter(dim, width, first(l, :), all_to, w, d, l, .true., a)
        worst(4) = max(worst(4), maxval(abs(all_to - to)))
        other = sum(g*all_to)
        worst(5) = max(worst(5), abs(one - other))
      end do
    end do
    call check(worst(1), 0.0_wp, tolerance, "gather is the list's"//which)
    call check(worst(2), 0.0_wp, tolerance, "gather of values is the list's"//which)
    call check(worst(3), 0.0_wp, tolerance, "scatter of values is the list's"//which)
    call check(worst(4), 0.0_wp, tolerance, "scatter is the list's"//which)
    call check(worst(5), 0.0_wp, 10*tolerance, "<g, S a> = <S^T g, a>"//which)
  end subroutine test_against_list

  subroutine fast_weights(dim, width, x, half, first, w, d)
    integer, intent(in) :: dim, width
    real(wp), intent(in) :: x(lanes, 3), half(lanes, 3)
    integer, intent(inout) :: first(lanes, 3)
    real(wp), intent(inout) :: w(lanes, 3, 3), d(lanes, 3, 3)
    real(wp) :: w2(lanes, 2, 3), d2(lanes, 2, 3), low(3), high(3)
    if (width == 2) then
      w2 = 0.0_wp
      d2 = 0.0_wp
      call weights_2(dim, x, first, w2, d2, low, high)
      w(:, :2, :) = w2
      d(:, :2, :) = d2
    else
      call weights_3(dim, x, half, first, w, d, low, high)
    end if
    call check_true(all(nint(low(:dim)) == minval(first(:, :dim), 1)) .and. all(nint(high(:dim)) == maxval(first(:, :dim), 1)), &
                    "the range of first nodes")
  end subroutine fast_weights

  !> The kernel of that dimension and width, on arrays with the strides of a pad
  subroutine fast_gather(dim, width, first, g, w, d, l, gradients, got)
    integer, intent(in) :: dim, width, first(3), l
    real(wp), intent(in) :: g(nf, 0:4, 0:4, 0:4), w(lanes, 3, 3), d(lanes, 3, 3)
    logical, intent(in) :: gradients
    real(wp), intent(inout) :: got(nf, lanes, 4)
    real(wp) :: pad1(nf, 0:row_1d - 1), pad2(nf, 0:row_2d - 1, 0:4), pad3(nf, 0:row_3d - 1, 0:rows_3d - 1, 0:4)
    real(wp) :: w2(lanes, 2, 3), d2(lanes, 2, 3)
    integer :: b(3)
    b = first
    w2 = w(:, :2, :)
    d2 = d(:, :2, :)
    pad1 = 0.0_wp
    pad2 = 0.0_wp
    pad3 = 0.0_wp
    pad1(:, 0:4) = g(:, :, 0, 0)
    pad2(:, 0:4, :) = g(:, :, :, 0)
    pad3(:, 0:4, 0:4, :) = g
    select case (10*dim + width)
    case (12)
      if (gradients) call gather_1d_2(pad1(1, b(1)), w2, d2, l, got)
      if (.not. gradients) call gather_value_1d_2(pad1(1, b(1)), w2, l, got)
    case (13)
      if (gradients) call gather_1d_3(pad1(1, b(1)), w, d, l, got)
      if (.not. gradients) call gather_value_1d_3(pad1(1, b(1)), w, l, got)
    case (22)
      if (gradients) call gather_2d_2(pad2(1, b(1), b(2)), w2, d2, l, got)
      if (.not. gradients) call gather_value_2d_2(pad2(1, b(1), b(2)), w2, l, got)
    case (23)
      if (gradients) call gather_2d_3(pad2(1, b(1), b(2)), w, d, l, got)
      if (.not. gradients) call gather_value_2d_3(pad2(1, b(1), b(2)), w, l, got)
    case (32)
      if (gradients) call gather_3d_2(pad3(1, b(1), b(2), b(3)), w2, d2, l, got)
      if (.not. gradients) call gather_value_3d_2(pad3(1, b(1), b(2), b(3)), w2, l, got)
    case (33)
      if (gradients) call gather_3d_3(pad3(1, b(1), b(2), b(3)), w, d, l, got)
      if (.not. gradients) call gather_value_3d_3(pad3(1, b(1), b(2), b(3)), w, l, got)
    end select
  end subroutine fast_gather

  subroutine fast_scatter(dim, width, first, g, w, d, l, gradients, a)
    integer, intent(in) :: dim, width, first(3), l
    real(wp), intent(inout) :: g(nf, 0:4, 0:4, 0:4)
    real(wp), intent(in) :: w(lanes, 3, 3), d(lanes, 3, 3), a(nf, lanes, 4)
    logical, intent(in) :: gradients
    real(wp) :: pad1(nf, 0:row_1d - 1), pad2(nf, 0:row_2d - 1, 0:4), pad3(nf, 0:row_3d - 1, 0:rows_3d - 1, 0:4)
    real(wp) :: w2(lanes, 2, 3), d2(lanes, 2, 3)
    integer :: b(3)
    b = first
    w2 = w(:, :2, :)
    d2 = d(:, :2, :)
    pad1 = 0.0_wp
    pad2 = 0.0_wp
    pad3 = 0.0_wp
    pad1(:, 0:4) = g(:, :, 0, 0)
    pad2(:, 0:4, :) = g(:, :, :, 0)
    pad3(:, 0:4, 0:4, :) = g
    select case (10*dim + width)
    case (12)
      if (gradients) call scatter_1d_2(pad1(1, b(1)), w2, d2, l, a)
      if (.not. gradients) call scatter_value_1d_2(pad1(1, b(1)), w2, l, a)
    case (13)
      if (gradients) call scatter_1d_3(pad1(1, b(1)), w, d, l, a)
      if (.not. gradients) call scatter_value_1d_3(pad1(1, b(1)), w, l, a)
    case (22)
      if (gradients) call scatter_2d_2(pad2(1, b(1), b(2)), w2, d2, l, a)
      if (.not. gradients) call scatter_value_2d_2(pad2(1, b(1), b(2)), w2, l, a)
    case (23)
      if (gradients) call scatter_2d_3(pad2(1, b(1), b(2)), w, d, l, a)
      if (.not. gradients) call scatter_value_2d_3(pad2(1, b(1), b(2)), w, l, a)
    case (32)
      if (gradients) call scatter_3d_2(pad3(1, b(1), b(2), b(3)), w2, d2, l, a)
      if (.not. gradients) call scatter_value_3d_2(pad3(1, b(1), b(2), b(3)), w2, l, a)
    case (33)
      if (gradients) call scatter_3d_3(pad3(1, b(1), b(2), b(3)), w, d, l, a)
      if (.not. gradients) call scatter_value_3d_3(pad3(1, b(1), b(2), b(3)), w, l, a)
    end select
    if (dim == 1) g(:, :, 0, 0) = pad1(:, 0:4)
    if (dim == 2) g(:, :, :, 0) = pad2(:, 0:4, :)
    if (dim == 3) g = pad3(:, 0:4, 0:4, :)
  end subroutine fast_scatter

  !> Places exactly on nodes, and domains that end on them: cells are half open, also below zero
  subroutine test_faces_of_cells()
    real(wp) :: x(lanes, 1), half(lanes, 1), w2(lanes, 2, 1), d2(lanes, 2, 1), w(lanes, 3, 1), d(lanes, 3, 1), low(3), high(3)
    integer :: first(lanes, 1)
    x(:, 1) = [0.0_wp, 1.0_wp, -1.0_wp, 1.0_wp - round_off, -1.0_wp + round_off, 3.25_wp, -0.25_wp, 7.0_wp]
    call weights_2(1, x, first, w2, d2, low, high)
    ! places between nodes closer than 64 epsilon may count as on the node: positions are shifted by 64 cells to be positive
    call check_true(all(first([1, 2, 3, 6, 7, 8], 1) == [0, 1, -1, 3, -1, 7]), "tents: the first node at and between nodes")
    call check(w2([1, 2, 3, 8], 1, 1), spread(1.0_wp, 1, 4), 0.0_wp, "a point on a node gives all to it")
    call check(maxval(abs(sum(w2, 2) - 1.0_wp)), 0.0_wp, round_off, "weights sum to one wherever the cell was cut")
    call check(maxval(abs(w2(:, 2, 1) - (x(:, 1) - first(:, 1)))), 0.0_wp, round_off, "and keep the place")
    half = 0.25_wp
    call weights_3(1, x, half, first, w, d, low, high)
    call check_true(all(first([1, 2, 3, 6, 7, 8], 1) == [-1, 0, -2, 3, -1, 6]), "domains: the first node in reach")
    call check(w(6, :, 1), [0.75_wp - 0.0_wp, 0.25_wp, 0.0_wp], round_off, "a domain that starts on a node")
    call check(w(1, :, 1), [0.0625_wp, 0.875_wp, 0.0625_wp], round_off, "a domain around a node")
    call check(d(1, :, 1), [-0.5_wp, 0.0_wp, 0.5_wp], round_off, "its slopes")
  end subroutine test_faces_of_cells

  subroutine test_turning()
    real(wp) :: a(nf, lanes), b(lanes, nf), c(nf, lanes), numbers(nf*lanes)
    call random_reals(seed, numbers)
    a = reshape(numbers, shape(a))
    call to_lanes(a, b)
    call check_true(all(b == transpose(a)), "fields in lanes become particles in lanes")
    call to_fields(b, c)
    call check_true(all(c == a), "and back")
  end subroutine test_turning

end program test_kernels
