!> Null-space filter (Gritton & Berzins 2017; Tran & Solowski 2019): what the velocities of the particles of a cell hold and its nodes
!> cannot see is taken out.
!>
!> With S the weights (particle, node) of a cell and M the masses of its particles, the velocities v become M^-1/2 P M^1/2 v, where P
!> projects on the range of M^1/2 S. The rest gives no momentum to any node, since S^T M v is as before. Constant and linear
!> fields lie in the range wherever the weights reproduce them, so that momentum and angular momentum stay. Only cells that hold
!> more particles than the rank of their weights change.
module gimp_null_space
  use gimp_kinds, only: wp, dp, lanes
  use gimp_over_ranks, only: sum_of
  use gimp_basis, only: weight_list_t
  use gimp_blocks, only: few_blocks
  use gimp_cells, only: find_cells
  use gimp_engine, only: engine_t
  use gimp_particle_list, only: particle_list
  implicit none(type, external)
  private
  public :: filter_velocities

  real(dp), parameter :: smallest_share = 1.0e-10_dp !! of the first diagonal term of R; smaller ones are round-off
  integer, parameter :: reach = 8 !! no support goes so far from the cell of its particle [cells]

  !> A particle of a cell
  type :: member_t
    integer :: chunk = 0, lane = 0
  end type member_t

  interface
    !> LAPACK: A P = Q R with column pivoting
    subroutine dgeqp3(m, n, a, lda, jpvt, tau, work, lwork, info)
      import :: dp
      implicit none(type, external)
      integer, intent(in) :: m, n, lda, lwork
      real(dp), intent(inout) :: a(lda, *)
      integer, intent(inout) :: jpvt(*)
      real(dp), intent(out) :: tau(*), work(*)
      integer, intent(out) :: info
    end subroutine dgeqp3

    !> LAPACK: C <- Q C or Q^T C
    subroutine dormqr(side, trans, m, n, k, a, lda, tau, c, ldc, work, lwork, info)
      import :: dp
      implicit none(type, external)
      character, intent(in) :: side, trans
      integer, intent(in) :: m, n, k, lda, ldc, lwork
      real(dp), intent(in) :: a(lda, *), tau(*)
      real(dp), intent(inout) :: c(ldc, *)
      real(dp), intent(out) :: work(*)
      integer, intent(out) :: info
    end subroutine dormqr
  end interface

contains

  !> Filter the velocities of all particles. They were just sorted: every particle of a cell lies in the block of the cell.
  subroutine filter_velocities(engine, taken)
    type(engine_t), intent(inout) :: engine
    real(dp), intent(out) :: taken !! kinetic energy [J]
    real(dp) :: part(engine%table%blocks)
    integer :: b
    !$omp parallel do schedule(dynamic, 1) if(engine%table%blocks > few_blocks)
    do b = 1, engine%table%blocks
      call filter_block(engine, b, part(b))
    end do
    !$omp end parallel do
    taken = sum_of(part)
  end subroutine filter_velocities

  subroutine filter_block(engine, b, taken)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: b
    real(dp), intent(out) :: taken
    type(member_t), allocatable :: members(:)
    integer, allocatable :: first(:) ! (cells + 1) of `members`
    integer :: k
    taken = 0.0_dp
    call gather_members(engine, b, members, first)
    do k = 1, size(first) - 1
      if (first(k + 1) - first(k) > 1) call filter_cell(engine, b, members(first(k):first(k + 1) - 1), taken)
    end do
    call renew_twins(engine, b)
  end subroutine filter_block

  !> The particles of a block by cells, in their stored order
  subroutine gather_members(engine, b, members, first)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: b
    type(member_t), allocatable, intent(out) :: members(:)
    integer, allocatable, intent(out) :: first(:)
    integer, allocatable :: home(:, :), next(:)
    integer :: cell(3, lanes), c, l, low, high
    low = engine%particles%groups(engine%particles%block_group(b))%first
    high = engine%particles%groups(engine%particles%block_group(b + 1) - 1)%last
    allocate (home(lanes, low:high), source=0)
    allocate (first(product(engine%grid%edge) + 1), source=0)
    do c = low, high
      call find_cells(engine, engine%table%block_at(:, b), engine%particles%p(:, :engine%grid%dim, c), cell)
      do l = 1, lanes
        if (engine%particles%id(l, c) == 0) cycle
        cell(:, l) = min(max(cell(:, l), 0), engine%grid%edge - 1) ! beyond the box
        home(l, c) = 1 + cell(1, l) + engine%grid%edge(1)*(cell(2, l) + engine%grid%edge(2)*cell(3, l))
        first(home(l, c) + 1) = first(home(l, c) + 1) + 1
      end do
    end do
    first(1) = 1
    do c = 2, size(first)
      first(c) = first(c) + first(c - 1)
    end do
    allocate (members(first(size(first)) - 1))
    allocate (next, source=first)
    do c = low, high
      do l = 1, lanes
        if (home(l, c) == 0) cycle
        members(next(home(l, c))) = member_t(c, l)
        next(home(l, c)) = next(home(l, c)) + 1
      end do
    end do
  end subroutine gather_members

  !> Project the velocities of the particles of one cell; their mean stays to round-off of its own size
  subroutine filter_cell(engine, b, members, taken)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: b
    type(member_t), intent(in) :: members(:)
    real(dp), intent(inout) :: taken !! kinetic energy so far [J]
    real(dp) :: m(size(members)), root(size(members)), mean(engine%grid%dim), v(size(members), engine%grid%dim), w(size(members), engine%grid%dim)
    real(dp), allocatable :: a(:, :)
    integer :: d, k, n, q, rank
    d = engine%grid%dim
    n = size(members)
    q = engine%particles%velocity%first
    do k = 1, n
      m(k) = real(engine%particles%p(members(k)%lane, engine%particles%mass%first, members(k)%chunk), dp)
      v(k, :) = real(engine%particles%p(members(k)%lane, q:q + d - 1, members(k)%chunk), dp)
    end do
    root = sqrt(m)
    mean = matmul(m, v)/sum(m)
    do k = 1, d
      w(:, k) = root*(v(:, k) - mean(k))
    end do
    call weights_of_cell(engine, b, members, a)
    a = spread(root, 2, size(a, 2))*a
    call project(a, w, rank)
    if (rank == n) return ! nodes see everything: not a bit changes
    do k = 1, d
      w(:, k) = w(:, k)/root
      w(:, k) = mean(k) + (w(:, k) - dot_product(m, w(:, k))/sum(m))
    end do
    do k = 1, n
      engine%particles%p(members(k)%lane, q:q + d - 1, members(k)%chunk) = real(w(k, :), wp)
      taken = taken + 0.5_dp*m(k)*(sum(v(k, :)**2) - sum(w(k, :)**2))
    end do
  end subroutine filter_cell

  !> Weights (particle, node) of the particles of one cell on all nodes that they reach
  subroutine weights_of_cell(engine, b, members, a)
    type(engine_t), intent(in) :: engine
    integer, intent(in) :: b
    type(member_t), intent(in) :: members(:)
    real(dp), allocatable, intent(out) :: a(:, :)
    type(weight_list_t), allocatable :: list(:)
    integer :: column(-reach:reach, -reach:reach, -reach:reach), origin(3), at(3), i, k, columns
    allocate (list(size(members)))
    column = 0
    columns = 0
    do k = 1, size(members)
      call particle_list(engine, engine%table%block_at(:, b), members(k)%chunk, members(k)%lane, list(k))
      if (k == 1) origin = list(1)%node(:, 1)
      do i = 1, list(k)%n
        at = list(k)%node(:, i) - origin
        if (column(at(1), at(2), at(3)) > 0) cycle
        columns = columns + 1
        column(at(1), at(2), at(3)) = columns
      end do
    end do
    allocate (a(size(members), columns), source=0.0_dp)
    do k = 1, size(members)
      do i = 1, list(k)%n
        at = list(k)%node(:, i) - origin
        associate (weight => a(k, column(at(1), at(2), at(3))))
          weight = weight + real(list(k)%s(i), dp)
        end associate
      end do
    end do
  end subroutine weights_of_cell

  !> Project the columns of w on the range of a, whose rank is found; a is used up
  subroutine project(a, w, rank)
    real(dp), intent(inout) :: a(:, :), w(:, :)
    integer, intent(out) :: rank
    real(dp) :: tau(min(size(a, 1), size(a, 2))), work(3*size(a, 2) + 1 + size(w, 2))
    integer :: pivot(size(a, 2)), k, info
    pivot = 0
    call dgeqp3(size(a, 1), size(a, 2), a, size(a, 1), pivot, tau, work, 3*size(a, 2) + 1, info)
    rank = 0
    do k = 1, size(tau)
      if (abs(a(k, k)) > smallest_share*abs(a(1, 1))) rank = k
    end do
    if (rank == size(a, 1)) return
    call dormqr("L", "T", size(w, 1), size(w, 2), size(tau), a, size(a, 1), tau, w, size(w, 1), work, size(work), info)
    w(rank + 1:, :) = 0.0_dp
    call dormqr("L", "N", size(w, 1), size(w, 2), size(tau), a, size(a, 1), tau, w, size(w, 1), work, size(work), info)
  end subroutine project

  !> Spare lanes move with the first lane of their chunk
  subroutine renew_twins(engine, b)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: b
    integer :: c, l, q
    q = engine%particles%velocity%first
    do c = engine%particles%groups(engine%particles%block_group(b))%first, &
      engine%particles%groups(engine%particles%block_group(b + 1) - 1)%last
      do l = 2, lanes
        if (engine%particles%id(l, c) > 0) cycle
        engine%particles%p(l, q:q + engine%grid%dim - 1, c) = engine%particles%p(1, q:q + engine%grid%dim - 1, c)
      end do
    end do
  end subroutine renew_twins

end module gimp_null_space
