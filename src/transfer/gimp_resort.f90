!> Sort: every particle goes to the block of its support, in the order block, material, cell, id, and the tables of active
!> blocks are built anew. Sorts happen rarely and are decided for the whole run at once.
!>
!> Chunks are cut into parts, a few for each thread. A part finds the blocks of its particles and counts them; the parts agree on
!> the numbers of the blocks and on who puts its particles where in a group; at last every group is brought into the order
!> of cell and id, which forgets who put what where: the result does not depend on the parts.
module gimp_resort
  use gimp_kinds, only: wp, i8, lanes
  use gimp_grid, only: block_key, block_at_key, nodes_per_block
  use gimp_hash_table, only: hash_table_t, clear_table, insert_key
  use gimp_sorting, only: rank_keys, sort_order
  use gimp_particles, only: particles_t, group_t, few_chunks
  use gimp_reorder, only: reorder_particles, reorder_bytes
  use gimp_homes, only: shift_chunk
  use gimp_borders, only: build_tables
  use gimp_migration, only: migrate, balance
  use gimp_over_ranks, only: sum_counts
  use gimp_engine, only: engine_t, allot_grid, borrow_pads
  use omp_lib, only: omp_get_max_threads
  use, intrinsic :: iso_c_binding, only: c_ptr, c_f_pointer
  implicit none(type, external)
  private
  public :: sort_particles

  integer, parameter :: spare = -1 !! the source of a lane without a particle
  integer, parameter :: most_in_part = 2**21 !! chunks: `home` has room for a block for each of their particles
  integer, parameter :: few_groups = 16 !! not worth waking other threads for
  integer, parameter :: few = 32 !! particles of a cell that are put in order by insertion

  !> Consecutive chunks that one thread works on, and the blocks that their particles go to
  type :: part_t
    integer :: first = 1, last = 0 !! chunks
    integer :: group = 1 !! of the first chunk
    type(hash_table_t) :: table !! key of a block -> its number in this part
    integer :: blocks = 0
    integer(i8), allocatable :: key(:) !! (block of this part)
    integer, allocatable :: block(:) !! (block of this part) its number in the run
    integer, allocatable :: count(:, :) !! (material, block of this part) particles
    integer(i8), allocatable :: place(:, :) !! (material, block of this part) where its next particle goes
  end type part_t

contains

  !> Sort all particles; those marked in `remove` (by chunk and lane) are dropped. Those that left the blocks of this rank go to the
  !> ranks that own theirs, and now and then blocks change hands so that all ranks have the same work. Collective
  subroutine sort_particles(engine, remove)
    type(engine_t), intent(inout) :: engine
    logical, allocatable, intent(inout), optional :: remove(:, :) !! (lane, chunk); used up
    logical, allocatable :: gone(:, :)
    integer, allocatable :: block_at(:, :)
    if (present(remove)) call move_alloc(remove, gone)
    call migrate(engine, gone)
    call sort_here(engine, block_at, gone)
    call balance(engine, block_at)
    call build_tables(engine, block_at)
    call allot_grid(engine)
    engine%particles%n_all = sum_counts(engine%particles%n)
  end subroutine sort_particles

  !> Sort the particles of this rank
  subroutine sort_here(engine, block_at, remove)
    type(engine_t), intent(inout) :: engine
    integer, allocatable, intent(out) :: block_at(:, :) !! (3, block) blocks that hold them
    logical, allocatable, intent(in) :: remove(:, :) !! (lane, chunk) these are dropped
    type(part_t), allocatable :: parts(:)
    type(group_t), allocatable :: groups(:)
    integer, allocatable :: home(:, :), in_group(:)
    integer(i8), pointer, contiguous :: source(:)
    type(c_ptr) :: memory, buffer
    integer(i8) :: source_bytes
    integer :: k, chunks

    call cut_chunks(engine%particles, parts)
    allocate (home(lanes, engine%particles%chunks))
    !$omp parallel do schedule(dynamic, 1) if(size(parts) > 1)
    do k = 1, size(parts)
      call find_homes(engine, parts(k), home, remove)
    end do
    !$omp end parallel do
    call number_blocks(parts, block_at)
    call make_groups(engine, block_at, parts, groups, in_group)
    chunks = 0
    if (size(groups) > 0) chunks = groups(size(groups))%last
    source_bytes = source_size(chunks)
    call borrow_pads(engine, [source_bytes, reorder_bytes(chunks)], memory, buffer)
    call c_f_pointer(memory, source, [int(lanes, i8)*chunks])
    !$omp parallel do schedule(dynamic, 1) if(size(parts) > 1)
    do k = 1, size(parts)
      call list_sources(engine%particles, parts(k), home, source)
    end do
    !$omp end parallel do
    deallocate (home)
    call order_groups(engine%particles%id, groups, in_group, source)
    call reorder_particles(engine%particles, chunks, source, buffer)
    call move_alloc(groups, engine%particles%groups)
    engine%particles%n = sum(int(in_group, i8))
  end subroutine sort_here

  !> Bytes of the list of sources
  pure integer(i8) function source_size(chunks)
    integer, intent(in) :: chunks
    source_size = int(storage_size(1_i8)/8, i8)*lanes*max(1, chunks)
  end function source_size

  !> Equal parts of the chunks
  subroutine cut_chunks(particles, parts)
    type(particles_t), intent(in) :: particles
    type(part_t), allocatable, intent(out) :: parts(:)
    integer :: k, g, n
    n = omp_get_max_threads()
    if (n > 1) n = 4*n
    n = max(1, min(n, particles%chunks/few_chunks), particles%chunks/most_in_part + 1)
    allocate (parts(n))
    g = 1
    do k = 1, n
      parts(k)%first = 1 + int(int(particles%chunks, i8)*(k - 1)/n)
      parts(k)%last = int(int(particles%chunks, i8)*k/n)
      do while (g < size(particles%groups))
        if (particles%groups(g)%last >= parts(k)%first) exit
        g = g + 1
      end do
      parts(k)%group = g
    end do
  end subroutine cut_chunks

  !> Block and cell of all particles of a part: `home` is cell + nodes_per_block*(block of the part), 0 for spare lanes.
  !> Positions wrap around periodic axes and become relative to the new block.
  subroutine find_homes(engine, part, home, remove)
    type(engine_t), intent(inout) :: engine
    type(part_t), intent(inout) :: part
    integer, intent(inout) :: home(lanes, engine%particles%chunks)
    logical, allocatable, intent(in) :: remove(:, :) !! (lane, chunk)
    integer :: off(lanes, 3), cell(lanes), g, c, l, here, last, last_off(3)
    logical :: stay

    call clear_table(part%table, 64)
    allocate (part%key(64), part%count(size(engine%laws), 64))
    part%count = 0
    off = 0
    associate (particles => engine%particles)
      do g = part%group, size(particles%groups)
        if (particles%groups(g)%first > part%last) exit
        here = 0 ! number of the group's own block, when it is known
        last = 0
        last_off = huge(1)
        do c = max(part%first, particles%groups(g)%first), min(part%last, particles%groups(g)%last)
          call shift_chunk(engine, particles%groups(g)%at, particles%components, particles%p(:, :, c), off, cell)
          stay = all(off == 0)
          do l = 1, lanes
            home(l, c) = 0
            if (particles%id(l, c) == 0) cycle
            if (allocated(remove)) then
              if (remove(l, c)) cycle
            end if
            if (stay .or. all(off(l, :) == 0)) then
              if (here == 0) call find_block(part, block_key(particles%groups(g)%at), here)
              last = here
              last_off = 0
            else if (any(off(l, :) /= last_off)) then
              last_off = off(l, :)
              call find_block(part, block_key(particles%groups(g)%at + last_off), last)
            end if
            home(l, c) = cell(l) + nodes_per_block*last
            part%count(particles%groups(g)%material, last) = part%count(particles%groups(g)%material, last) + 1
          end do
        end do
      end do
    end associate
  end subroutine find_homes

  !> Number of a block in a part
  subroutine find_block(part, key, number)
    type(part_t), intent(inout) :: part
    integer(i8), intent(in) :: key
    integer, intent(out) :: number
    integer, allocatable :: wider(:, :)
    call insert_key(part%table, key, part%blocks + 1, number)
    if (number <= part%blocks) return
    if (number > size(part%key)) then
      part%key = [part%key, part%key]
      allocate (wider(size(part%count, 1), size(part%key)), source=0)
      wider(:, :part%blocks) = part%count
      call move_alloc(wider, part%count)
    end if
    part%blocks = number
    part%key(number) = key
  end subroutine find_block

  !> Number the blocks of all parts in the order of their keys
  subroutine number_blocks(parts, block_at)
    type(part_t), intent(inout) :: parts(:)
    integer, allocatable, intent(out) :: block_at(:, :) !! (3, block)
    integer(i8), allocatable :: keys(:), distinct(:)
    integer, allocatable :: rank(:)
    integer :: k, n, b
    allocate (keys(sum(parts%blocks)))
    n = 0
    do k = 1, size(parts)
      keys(n + 1:n + parts(k)%blocks) = parts(k)%key(:parts(k)%blocks)
      n = n + parts(k)%blocks
    end do
    call rank_keys(keys, distinct, rank)
    n = 0
    do k = 1, size(parts)
      parts(k)%block = rank(n + 1:n + parts(k)%blocks)
      n = n + parts(k)%blocks
    end do
    allocate (block_at(3, size(distinct)))
    do b = 1, size(distinct)
      block_at(:, b) = block_at_key(distinct(b))
    end do
  end subroutine number_blocks

  !> The groups, and where every part puts its particles
  subroutine make_groups(engine, block_at, parts, groups, in_group)
    type(engine_t), intent(inout) :: engine
    integer, intent(in) :: block_at(:, :) !! (3, block)
    type(part_t), intent(inout) :: parts(:)
    type(group_t), allocatable, intent(out) :: groups(:)
    integer, allocatable, intent(out) :: in_group(:) !! (group) particles
    integer, allocatable :: total(:, :) ! (material, block)
    integer(i8), allocatable :: next(:, :) ! (material, block) place
    integer :: k, b, m, n, chunks
    allocate (total(size(engine%laws), size(block_at, 2)), source=0)
    allocate (next(size(engine%laws), size(block_at, 2)), source=0_i8)
    do k = 1, size(parts)
      do b = 1, parts(k)%blocks
        total(:, parts(k)%block(b)) = total(:, parts(k)%block(b)) + parts(k)%count(:, b)
      end do
    end do
    allocate (groups(count(total > 0)))
    allocate (in_group(size(groups)))
    if (allocated(engine%particles%block_group)) deallocate (engine%particles%block_group)
    allocate (engine%particles%block_group(size(block_at, 2) + 1))
    n = 0
    chunks = 0
    do b = 1, size(block_at, 2)
      engine%particles%block_group(b) = n + 1
      do m = 1, size(engine%laws)
        if (total(m, b) == 0) cycle
        n = n + 1
        next(m, b) = int(lanes, i8)*chunks
        groups(n) = group_t(b, m, chunks + 1, chunks + (total(m, b) + lanes - 1)/lanes, block_at(:, b))
        in_group(n) = total(m, b)
        chunks = groups(n)%last
      end do
    end do
    engine%particles%block_group(size(block_at, 2) + 1) = n + 1
    do k = 1, size(parts)
      allocate (parts(k)%place(size(engine%laws), parts(k)%blocks))
      do b = 1, parts(k)%blocks
        parts(k)%place(:, b) = next(:, parts(k)%block(b))
        next(:, parts(k)%block(b)) = next(:, parts(k)%block(b)) + parts(k)%count(:, b)
      end do
    end do
  end subroutine make_groups

  !> Put cell + nodes_per_block*(old lane, from 0) of every particle of a part where its group is
  subroutine list_sources(particles, part, home, source)
    type(particles_t), intent(in) :: particles
    type(part_t), intent(inout) :: part
    integer, intent(in) :: home(lanes, particles%chunks)
    integer(i8), intent(inout) :: source(0:*)
    integer :: g, c, l, b, m
    do g = part%group, size(particles%groups)
      if (particles%groups(g)%first > part%last) exit
      m = particles%groups(g)%material
      do c = max(part%first, particles%groups(g)%first), min(part%last, particles%groups(g)%last)
        do l = 1, lanes
          b = home(l, c)/nodes_per_block
          if (b == 0) cycle
          source(part%place(m, b)) = modulo(home(l, c), nodes_per_block) &
                                     + nodes_per_block*(lanes*(c - 1_i8) + (l - 1))
          part%place(m, b) = part%place(m, b) + 1
        end do
      end do
    end do
  end subroutine list_sources

  !> Bring every group into the order of cell and id; `source` then holds old lanes
  subroutine order_groups(old_id, groups, in_group, source)
    integer(i8), intent(in) :: old_id(0:*)
    type(group_t), intent(in) :: groups(:)
    integer, intent(in) :: in_group(:)
    integer(i8), intent(inout) :: source(0:*)
    integer(i8), allocatable :: lane(:), id(:)
    integer(i8) :: first
    integer :: g, most
    most = 0
    if (size(in_group) > 0) most = maxval(in_group)
    !$omp parallel private(lane, id, first) if(size(in_group) > few_groups)
    allocate (lane(most), id(most))
    !$omp do schedule(dynamic, 16)
    do g = 1, size(in_group)
      first = (groups(g)%first - 1_i8)*lanes
      call order_group(in_group(g), old_id, source(first), lane, id)
      source(first + in_group(g):int(lanes, i8)*groups(g)%last - 1) = spare
    end do
    !$omp end do
    !$omp end parallel
  end subroutine order_groups

  !> Stable counting sort by cell, then by id within the cells: nearly always already in place
  subroutine order_group(n, old_id, source, lane, id)
    integer, intent(in) :: n
    integer(i8), intent(in) :: old_id(0:*)
    integer(i8), intent(inout) :: source(n)
    integer(i8), intent(inout) :: lane(n), id(n)
    integer :: start(0:nodes_per_block), i, k, cell
    start = 0
    do i = 1, n
      cell = int(modulo(source(i), int(nodes_per_block, i8))) + 1
      start(cell) = start(cell) + 1
    end do
    start(0) = 1
    do cell = 1, nodes_per_block
      start(cell) = start(cell) + start(cell - 1)
    end do
    do i = 1, n
      cell = int(modulo(source(i), int(nodes_per_block, i8)))
      k = start(cell)
      start(cell) = k + 1
      lane(k) = source(i)/nodes_per_block
      id(k) = old_id(lane(k))
    end do
    k = 1
    do cell = 0, nodes_per_block - 1 ! start(cell) is now where the cell ends
      if (start(cell) > k) call order_ids(start(cell) - k, lane(k), id(k))
      k = start(cell)
    end do
    source = lane
  end subroutine order_group

  !> Bring the particles of a cell into the order of their ids
  subroutine order_ids(n, lane, id)
    integer, intent(in) :: n
    integer(i8), intent(inout) :: lane(n), id(n)
    integer, allocatable :: order(:)
    integer(i8) :: this, that
    integer :: i, q
    if (n > few) then
      if (all(id(2:) > id(:n - 1))) return
      call sort_order(id, order)
      lane = lane(order)
      return
    end if
    do i = 2, n
      if (id(i) > id(i - 1)) cycle
      this = id(i)
      that = lane(i)
      q = i
      do while (q > 1)
        if (id(q - 1) < this) exit
        id(q) = id(q - 1)
        lane(q) = lane(q - 1)
        q = q - 1
      end do
      id(q) = this
      lane(q) = that
    end do
  end subroutine order_ids

end module gimp_resort
