!> The plain, readable transfer: it walks the weight list of every particle. It is the reference that the fast kernels are
!> tested against (`kernel = "list"`), and it serves the chunks whose supports are wider than the fast kernels allow.
!>
!> It works on the nodes of a block and of all its neighbours; what lies beyond the pad goes to the spill list.
module gimp_list_kernel
  use gimp_kinds, only: wp, i8, lanes
  use gimp_sorting, only: sort_order
  use gimp_grid, only: grid_t, nodes_per_block, nf => fields_per_node
  use gimp_blocks, only: block_table_t, neighbour
  use gimp_basis, only: weight_list_t
  use gimp_engine, only: spill_t, drift, make_room
  implicit none(type, external)
  private
  public :: wide_nodes, load_wide, gather_list, scatter_list, unload_wide, order_spill, add_spill, wide_place

contains

  !> Nodes of a block and its neighbours
  pure integer function wide_nodes(dim)
    integer, intent(in) :: dim
    wide_nodes = nodes_per_block*3**dim
  end function wide_nodes

  !> Place of a node in the wide array; node coordinates relative to the block's origin
  pure integer function wide_place(grid, node) result(place)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: node(3)
    integer :: reach(3)
    reach = merge(grid%edge, 0, [1, 2, 3] <= grid%dim)
    place = 1 + (node(1) + reach(1)) + (grid%edge(1) + 2*reach(1))*((node(2) + reach(2)) &
      + (grid%edge(2) + 2*reach(2))*(node(3) + reach(3)))
  end function wide_place

  !> Copy the nodes around a block
  subroutine load_wide(grid, table, slots, g, block, wide)
    type(grid_t), intent(in) :: grid
    type(block_table_t), intent(in) :: table
    integer, intent(in) :: slots, block
    real(wp), intent(in) :: g(nf, nodes_per_block, slots)
    real(wp), intent(out) :: wide(nf, *)
    integer :: s, place, node(3), off(3), reach(3), dx, dy, dz
    reach = merge(1, 0, [1, 2, 3] <= grid%dim)
    do dz = -reach(3), reach(3)
      do dy = -reach(2), reach(2)
        do dx = -reach(1), reach(1)
          s = table%slot_near(neighbour(dx, dy, dz), block)
          off = [dx, dy, dz]*grid%edge
          do place = 0, nodes_per_block - 1
            node = off + node_at(grid, place)
            wide(:, wide_place(grid, node)) = g(:, place + 1, s)
          end do
        end do
      end do
    end do
  end subroutine load_wide

  pure function node_at(grid, place) result(node)
    type(grid_t), intent(in) :: grid
    integer, intent(in) :: place
    integer :: node(3)
    node = [modulo(place, grid%edge(1)), modulo(place/grid%edge(1), grid%edge(2)), place/(grid%edge(1)*grid%edge(2))]
  end function node_at

  !> Grid to particle: a(:, lane, 1) = sum S g, a(:, lane, 1 + k) = sum G_k g (or moments S (x_i - x_p)_k, if the list holds them)
  pure subroutine gather_list(grid, list, lane, wide, a)
    type(grid_t), intent(in) :: grid
    type(weight_list_t), intent(in) :: list !! nodes relative to the block's origin
    integer, intent(in) :: lane
    real(wp), intent(in) :: wide(nf, *)
    real(wp), intent(inout) :: a(nf, lanes, 1 + grid%dim)
    integer :: i, k, place
    a(:, lane, :) = 0.0_wp
    do i = 1, list%n
      place = wide_place(grid, list%node(:, i))
      a(:, lane, 1) = a(:, lane, 1) + list%s(i)*wide(:, place)
      do k = 1, grid%dim
        a(:, lane, 1 + k) = a(:, lane, 1 + k) + list%g(k, i)*wide(:, place)
      end do
    end do
  end subroutine gather_list

  !> Particle to grid, the transpose
  pure subroutine scatter_list(grid, list, lane, wide, a)
    type(grid_t), intent(in) :: grid
    type(weight_list_t), intent(in) :: list
    integer, intent(in) :: lane
    real(wp), intent(inout) :: wide(nf, *)
    real(wp), intent(in) :: a(nf, lanes, 1 + grid%dim)
    integer :: i, k, place
    do i = 1, list%n
      place = wide_place(grid, list%node(:, i))
      wide(:, place) = wide(:, place) + list%s(i)*a(:, lane, 1)
      do k = 1, grid%dim
        wide(:, place) = wide(:, place) + list%g(k, i)*a(:, lane, 1 + k)
      end do
    end do
  end subroutine scatter_list

  !> Add what a block collected to its pad, and what lies beyond the pad to the spill list; leaves `wide` empty
  subroutine unload_wide(grid, table, block, edge, wide, pad, spill)
    type(grid_t), intent(in) :: grid
    type(block_table_t), intent(in) :: table
    integer, intent(in) :: block, edge(3) !! edge of the pad in nodes
    real(wp), intent(inout) :: wide(nf, *), pad(nf, *)
    type(spill_t), intent(inout) :: spill
    integer :: s, place, node(3), off(3), reach(3), low(3), dx, dy, dz, w
    reach = merge(1, 0, [1, 2, 3] <= grid%dim)
    low = -drift*reach
    do dz = -reach(3), reach(3)
      do dy = -reach(2), reach(2)
        do dx = -reach(1), reach(1)
          s = table%slot_near(neighbour(dx, dy, dz), block)
          off = [dx, dy, dz]*grid%edge
          do place = 0, nodes_per_block - 1
            node = off + node_at(grid, place)
            w = wide_place(grid, node)
            if (all(wide(:, w) == 0.0_wp)) cycle
            if (all(node >= low .and. node < low + edge)) then
              node = node - low
              associate (q => 1 + node(1) + edge(1)*(node(2) + edge(2)*node(3)))
                pad(:, q) = pad(:, q) + wide(:, w)
              end associate
            else
              call add_spill(spill, block, s, place + 1, wide(:, w))
            end if
            wide(:, w) = 0.0_wp
          end do
        end do
      end do
    end do
  end subroutine unload_wide

  !> Join the spill lists of all threads, in the order of slots and blocks, whichever thread came first
  subroutine order_spill(spilled, spill)
    type(spill_t), intent(inout) :: spilled(:) !! (thread) empty afterwards
    type(spill_t), intent(inout) :: spill
    integer, allocatable :: order(:)
    integer(i8), allocatable :: key(:)
    type(spill_t) :: all
    integer :: t, k, n
    n = sum(spilled%n)
    spill%n = n
    if (n == 0) return
    call make_room(all, n)
    do t = 1, size(spilled)
      if (spilled(t)%n == 0) cycle
      associate (from => spilled(t), first => all%n + 1, last => all%n + spilled(t)%n)
        all%block(first:last) = from%block(:from%n)
        all%slot(first:last) = from%slot(:from%n)
        all%place(first:last) = from%place(:from%n)
        all%value(:, first:last) = from%value(:, :from%n)
      end associate
      all%n = all%n + spilled(t)%n
      spilled(t)%n = 0
    end do
    allocate (key(n))
    key = shiftl(int(all%slot(:n), i8), 32) + all%block(:n) ! what one block gives to one slot stays in its order
    call sort_order(key, order)
    spill%n = 0
    call make_room(spill, n)
    spill%n = n
    !$omp parallel do schedule(static) if(n > 1000)
    do k = 1, n
      spill%block(k) = all%block(order(k))
      spill%slot(k) = all%slot(order(k))
      spill%place(k) = all%place(order(k))
      spill%value(:, k) = all%value(:, order(k))
    end do
    !$omp end parallel do
  end subroutine order_spill

  !> One more entry
  subroutine add_spill(spill, block, slot, place, value)
    type(spill_t), intent(inout) :: spill
    integer, intent(in) :: block, slot, place
    real(wp), intent(in) :: value(nf)
    if (.not. allocated(spill%slot)) call make_room(spill, 64)
    if (spill%n == size(spill%slot)) call make_room(spill, 2*spill%n)
    spill%n = spill%n + 1
    spill%block(spill%n) = block
    spill%slot(spill%n) = slot
    spill%place(spill%n) = place
    spill%value(:, spill%n) = value
  end subroutine add_spill

end module gimp_list_kernel
