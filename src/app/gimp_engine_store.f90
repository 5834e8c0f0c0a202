!> Particles, blocks and pads in a checkpoint: each rank writes and reads its own rows of the datasets.
!>
!> A group names its block and its chunks by their numbers among those of all ranks, and a node beyond a pad by the key of its grid
!> block, so that the file does not tell how many ranks wrote it. A run that goes on cuts the groups anew, for the ranks that it has.
module gimp_engine_store
  use gimp_kinds, only: wp, dp, i8, lanes, precision_word
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_sorting, only: sort_order
  use gimp_shares, only: share_t, items_of_share
  use gimp_ranks, only: this_rank, ranks, gather_words
  use gimp_over_ranks, only: share_error, sum_counts
  use gimp_cuts, only: find_cuts, work_of_ranks
  use gimp_hash_table, only: find_key
  use gimp_grid, only: nf => fields_per_node, block_key
  use gimp_particles, only: group_t
  use gimp_engine, only: engine_t, spill_t, n_sums, work_of_pad, clear_unused, make_room
  use gimp_borders, only: send_pads
  use gimp_particle_pass, only: tell_signs, complete_pads
  use gimp_list_kernel, only: order_spill
  use gimp_hdf5, only: hdf5_file_t, create_group, dataset_shape, read_dataset, write_text, read_text
  use gimp_shared_hdf5, only: shared_file_t, announce_rows, rows_before, write_rows
  use gimp_saved_state, only: recall_groups
  implicit none(type, external)
  private
  public :: describe_engine, announce_engine, write_engine, read_engine

  integer, parameter :: piece_numbers = 2**20, piece_groups = 2**17 !! read at a time
  integer, parameter :: group_numbers = 7 !! block, material, first and last chunk, position of the block
  character(len=6), parameter :: real_kind = merge("double", "single", wp == dp)

contains

  ! ------------------------------------------------------------------------------------------------ writing

  !> What is told once, by the first rank
  subroutine describe_engine(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    call create_group(file, "particles", error)
    if (.not. allocated(error)) call write_text(file, "particles/fields", list_fields(engine), error)
    if (.not. allocated(error)) call create_group(file, "blocks", error)
    if (.not. allocated(error)) call create_group(file, "spill", error)
  end subroutine describe_engine

  !> Rows that this rank will write
  subroutine announce_engine(shared, engine)
    type(shared_file_t), intent(inout) :: shared
    type(engine_t), intent(in) :: engine
    integer(i8) :: chunks, blocks, entries
    chunks = engine%particles%chunks
    blocks = engine%table%blocks
    entries = count(engine%spill%block(:engine%spill%n) <= engine%table%blocks, kind=i8)
    call announce_rows(shared, "particles/groups", "int64", size(engine%particles%groups, kind=i8), group_numbers)
    call announce_rows(shared, "particles/values", real_kind, chunks, lanes*engine%particles%components)
    call announce_rows(shared, "particles/id", "int64", chunks, lanes)
    call announce_rows(shared, "blocks/pads", real_kind, blocks, nf*size(engine%pad, 2))
    call announce_rows(shared, "blocks/sums", "double", blocks, n_sums)
    call announce_rows(shared, "blocks/marks", "int32", blocks, 2)
    call announce_rows(shared, "spill/places", "int64", entries, 3)
    call announce_rows(shared, "spill/values", real_kind, entries, nf)
  end subroutine announce_engine

  !> Write them; each rank by itself
  subroutine write_engine(shared, engine, error)
    type(shared_file_t), intent(in) :: shared
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    real(wp), pointer, contiguous :: flat(:, :)
    integer, allocatable :: marks(:, :)
    integer :: blocks
    blocks = engine%table%blocks
    call write_groups(shared, engine, error)
    if (blocks > 0) then
      flat(1:lanes*engine%particles%components, 1:engine%particles%chunks) => engine%particles%p
      if (.not. allocated(error)) call write_rows(shared, "particles/values", 1_i8, flat, error)
      if (.not. allocated(error)) call write_rows(shared, "particles/id", 1_i8, engine%particles%id, error)
      if (.not. allocated(error)) call write_pads(shared, engine, error)
      if (.not. allocated(error)) call write_rows(shared, "blocks/sums", 1_i8, engine%sums(:, :blocks), error)
      allocate (marks(2, blocks))
      marks(1, :) = merge(1, 0, engine%drifted(:blocks))
      marks(2, :) = merge(1, 0, engine%restless(:blocks))
      if (.not. allocated(error)) call write_rows(shared, "blocks/marks", 1_i8, marks, error)
    end if
    if (.not. allocated(error)) call write_spill(shared, engine, error)
  end subroutine write_engine

  subroutine write_groups(shared, engine, error)
    type(shared_file_t), intent(in) :: shared
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: rows(:, :)
    integer(i8) :: blocks, chunks
    integer :: g
    blocks = rows_before(shared, "blocks/marks")
    chunks = rows_before(shared, "particles/id")
    allocate (rows(group_numbers, size(engine%particles%groups)))
    do g = 1, size(rows, 2)
      associate (group => engine%particles%groups(g))
        rows(1, g) = blocks + group%block
        rows(2, g) = group%material
        rows(3:4, g) = chunks + [group%first, group%last]
        rows(5:7, g) = group%at
      end associate
    end do
    call write_rows(shared, "particles/groups", 1_i8, rows, error)
  end subroutine write_groups

  !> Pads, in pieces. Without drift their outermost nodes are not in use and hold anything: zeros in the file
  subroutine write_pads(shared, engine, error)
    type(shared_file_t), intent(in) :: shared
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    real(wp), allocatable :: pads(:, :, :)
    integer :: first, last, b, step
    step = max(1, piece_numbers/(nf*size(engine%pad, 2)))
    do first = 1, engine%table%blocks, step
      last = min(engine%table%blocks, first + step - 1)
      pads = engine%pad(:, :, first:last)
      do b = first, last
        call clear_unused(engine, b, pads(:, :, b - first + 1))
      end do
      call write_rows(shared, "blocks/pads", int(first, i8), reshape(pads, [nf*size(pads, 2), size(pads, 3)]), error)
      if (allocated(error)) return
    end do
  end subroutine write_pads

  !> What blocks of this rank gave to nodes beyond their pads: in the order of blocks, each in the order in which it is added
  subroutine write_spill(shared, engine, error)
    type(shared_file_t), intent(in) :: shared
    type(engine_t), intent(in) :: engine
    type(error_t), allocatable, intent(out) :: error
    integer, allocatable :: order(:)
    integer(i8), allocatable :: places(:, :)
    integer(i8) :: blocks
    integer :: k
    blocks = rows_before(shared, "blocks/marks")
    associate (spill => engine%spill)
      call sort_order(int(spill%block(:spill%n), i8), order)
      order = pack(order, spill%block(order) <= engine%table%blocks) ! others write what came from them
      allocate (places(3, size(order)))
      do k = 1, size(order)
        places(1, k) = blocks + spill%block(order(k))
        places(2, k) = block_key(engine%table%slot_at(:, spill%slot(order(k))))
        places(3, k) = spill%place(order(k))
      end do
      call write_rows(shared, "spill/places", 1_i8, places, error)
      if (.not. allocated(error)) call write_rows(shared, "spill/values", 1_i8, spill%value(:, order), error)
    end associate
  end subroutine write_spill

  !> "double precision, position 2, velocity 2, ...": what a particle stores, in order
  function list_fields(engine) result(list)
    type(engine_t), intent(in) :: engine
    character(len=:), allocatable :: list
    integer :: k
    list = precision_word//" precision"
    do k = 1, size(engine%particles%fields)
      list = list//", "//trim(engine%particles%fields(k)%name)//" "//text_of(engine%particles%fields(k)%components)
    end do
  end function list_fields

  ! ------------------------------------------------------------------------------------------------ reading

  !> Cut the groups of a checkpoint for the ranks that there are; each reads its own particles, blocks and pads. Collective
  subroutine read_engine(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(inout) :: engine
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: rows(:, :)
    character(len=:), allocatable :: fields
    type(group_t), allocatable :: groups(:)
    integer(i8) :: first_block, first_chunk
    integer :: g
    call read_text(file, "particles/fields", fields, error)
    if (.not. allocated(error)) then
      if (fields /= list_fields(engine)) call raise(error, file%path//": its particles have the fields "//fields &
                                                    //"; this scene wants "//list_fields(engine))
    end if
    call share_error(error)
    if (.not. allocated(error)) call read_own_groups(file, engine%border%cut, rows, error)
    if (allocated(error)) return
    first_block = 1
    first_chunk = 1
    if (size(rows, 2) > 0) then
      first_block = rows(1, 1)
      first_chunk = rows(3, 1)
    end if
    allocate (groups(size(rows, 2)))
    do g = 1, size(groups)
      groups(g) = group_t(int(rows(1, g) - first_block) + 1, int(rows(2, g)), int(rows(3, g) - first_chunk) + 1, &
                          int(rows(4, g) - first_chunk) + 1, int(rows(5:7, g)))
    end do
    call recall_groups(engine, groups)
    call read_values(file, engine, first_block, first_chunk, error)
    call share_error(error)
    if (.not. allocated(error)) call read_spill(file, engine, error)
    if (allocated(error)) return
    engine%particles%n = count(engine%particles%id > 0, kind=i8)
    engine%particles%n_all = sum_counts(engine%particles%n)
    call send_pads(engine, .false.)
    call tell_signs(engine)
    call complete_pads(engine, .false.) ! what blocks of other ranks gave
  end subroutine read_engine

  !> Find the cuts and read the groups of this rank. Each looks through a share of all groups for that. Collective
  subroutine read_own_groups(file, cut, rows, error)
    type(hdf5_file_t), intent(in) :: file
    integer(i8), allocatable, intent(out) :: cut(:) !! (0:ranks)
    integer(i8), allocatable, intent(out) :: rows(:, :)
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: keys(:), work(:), groups(:), extents(:)
    integer(i8) :: own(2), share(2)
    integer :: n
    allocate (cut(0:ranks))
    call dataset_shape(file, "particles/groups", extents, error)
    if (.not. allocated(error)) then
      share = items_of_share(share_t(this_rank, ranks), extents(2))
      call read_keys(file, share, keys, work, groups, n, error)
    end if
    call share_error(error)
    if (allocated(error)) return
    call find_cuts(keys(:n), work(:n), cut)
    own = rows_of_rank(keys(:n), groups(:n), cut)
    allocate (rows(group_numbers, own(2) - own(1) + 1))
    call read_numbers(file, "particles/groups", own(1), rows, error)
    call share_error(error)
  end subroutine read_own_groups

  !> Block keys of some groups in ascending order, with the counted work and the number of groups of each block
  subroutine read_keys(file, share, keys, work, groups, n, error)
    type(hdf5_file_t), intent(in) :: file
    integer(i8), intent(in) :: share(2) !! first and last group
    integer(i8), allocatable, intent(out) :: keys(:), work(:), groups(:)
    integer, intent(out) :: n
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: rows(:, :)
    integer(i8) :: first, last, key
    integer :: g
    allocate (keys(share(2) - share(1) + 1), work(share(2) - share(1) + 1), groups(share(2) - share(1) + 1))
    n = 0
    do first = share(1), share(2), piece_groups
      last = min(share(2), first + piece_groups - 1)
      call read_dataset(file, "particles/groups", rows, error, rows=[first, last])
      if (allocated(error)) return
      do g = 1, size(rows, 2)
        key = block_key(int(rows(5:7, g)))
        if (n > 0) then
          if (keys(n) == key) then
            work(n) = work(n) + rows(4, g) - rows(3, g) + 1
            groups(n) = groups(n) + 1
            cycle
          end if
        end if
        n = n + 1
        keys(n) = key
        work(n) = work_of_pad + rows(4, g) - rows(3, g) + 1
        groups(n) = 1
      end do
    end do
  end subroutine read_keys

  !> First and last of the rows that this rank owns, where each rank knows the owners of a share of all. Collective
  function rows_of_rank(keys, rows, cut) result(own)
    integer(i8), intent(in) :: keys(:), rows(:) !! ascending keys, and how many rows belong to each
    integer(i8), intent(in) :: cut(0:) !! first key of each rank
    integer(i8) :: own(2), owned(0:ranks - 1)
    call work_of_ranks(keys, rows, cut, owned)
    own = [sum(owned(:this_rank - 1)) + 1, sum(owned(:this_rank))]
  end function rows_of_rank

  !> Fill what was rebuilt; each rank by itself
  subroutine read_values(file, engine, first_block, first_chunk, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(inout) :: engine
    integer(i8), intent(in) :: first_block, first_chunk !! among those of all ranks
    type(error_t), allocatable, intent(out) :: error
    real(wp), pointer, contiguous :: flat(:, :)
    integer(i8), allocatable :: marks(:, :)
    real(dp), allocatable :: sums(:, :)
    integer :: blocks
    blocks = engine%table%blocks
    if (blocks == 0) return
    flat(1:lanes*engine%particles%components, 1:engine%particles%chunks) => engine%particles%p
    call read_reals(file, "particles/values", first_chunk, flat, error)
    if (.not. allocated(error)) call read_numbers(file, "particles/id", first_chunk, engine%particles%id, error)
    flat(1:nf*size(engine%pad, 2), 1:blocks) => engine%pad
    if (.not. allocated(error)) call read_reals(file, "blocks/pads", first_block, flat, error)
    if (.not. allocated(error)) call read_dataset(file, "blocks/sums", sums, error, rows=first_block + [0, blocks - 1])
    allocate (marks(2, blocks))
    if (.not. allocated(error)) call read_numbers(file, "blocks/marks", first_block, marks, error)
    if (.not. allocated(error)) call check_width(file, "blocks/sums", size(sums, 1), size(engine%sums, 1), error)
    if (allocated(error)) return
    engine%sums(:, :blocks) = sums
    engine%drifted(:blocks) = marks(1, :) /= 0
    engine%restless(:blocks) = marks(2, :) /= 0
  end subroutine read_values

  !> What blocks of this rank gave to nodes beyond their pads. Collective
  subroutine read_spill(file, engine, error)
    type(hdf5_file_t), intent(in) :: file
    type(engine_t), intent(inout) :: engine
    type(error_t), allocatable, intent(out) :: error
    type(spill_t) :: read(1)
    integer(i8), allocatable :: extents(:), places(:, :)
    real(dp), allocatable :: values(:, :)
    integer(i8) :: block_cut(0:ranks), share(2), own(2)
    integer :: k
    call dataset_shape(file, "spill/places", extents, error)
    call share_error(error)
    if (allocated(error)) return
    if (extents(2) == 0) return
    call cut_blocks(engine, block_cut)
    share = items_of_share(share_t(this_rank, ranks), extents(2))
    call read_dataset(file, "spill/places", places, error, rows=share)
    call share_error(error)
    if (allocated(error)) return
    own = rows_of_rank(places(1, :), [(1_i8, k=1, size(places, 2))], block_cut)
    call read_dataset(file, "spill/places", places, error, rows=own)
    if (.not. allocated(error)) call read_dataset(file, "spill/values", values, error, rows=own)
    if (.not. allocated(error)) call check_width(file, "spill/values", size(values, 1), nf, error)
    if (.not. allocated(error)) then
      call make_room(read(1), size(places, 2) + 1)
      read(1)%n = size(places, 2)
      do k = 1, read(1)%n
        read(1)%block(k) = int(places(1, k) - block_cut(this_rank)) + 1
        read(1)%slot(k) = find_key(engine%table%slot_of, places(2, k))
        read(1)%place(k) = int(places(3, k))
        read(1)%value(:, k) = real(values(:, k), wp)
      end do
      if (any(read(1)%slot(:read(1)%n) == 0)) call raise(error, file%path//": what is beyond pads is nowhere near")
    end if
    call share_error(error)
    if (.not. allocated(error)) call order_spill(read, engine%spill)
  end subroutine read_spill

  !> Numbers of the first blocks of the ranks. Collective
  subroutine cut_blocks(engine, cut)
    type(engine_t), intent(in) :: engine
    integer(i8), intent(out) :: cut(0:)
    integer(i8) :: blocks(1, 0:ranks - 1)
    integer :: r
    call gather_words([int(engine%table%blocks, i8)], blocks)
    cut(0) = 1
    do r = 0, ranks - 1
      cut(r + 1) = cut(r) + blocks(1, r)
    end do
  end subroutine cut_blocks

  !> Some rows of a dataset of reals, in pieces
  subroutine read_reals(file, path, first, rows, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: first
    real(wp), intent(inout) :: rows(:, :)
    type(error_t), allocatable, intent(out) :: error
    real(dp), allocatable :: values(:, :)
    integer :: from, to, k, step
    step = max(1, piece_numbers/size(rows, 1))
    do from = 1, size(rows, 2), step
      to = min(size(rows, 2), from + step - 1)
      call read_dataset(file, path, values, error, rows=first - 1 + [from, to])
      if (.not. allocated(error)) call check_width(file, path, size(values, 1), size(rows, 1), error)
      if (allocated(error)) return
      !$omp parallel do schedule(static)
      do k = from, to
        rows(:, k) = real(values(:, k - from + 1), wp) ! exact
      end do
      !$omp end parallel do
    end do
  end subroutine read_reals

  !> Some rows of a dataset of whole numbers, in pieces
  subroutine read_numbers(file, path, first, rows, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer(i8), intent(in) :: first
    integer(i8), intent(inout) :: rows(:, :)
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: values(:, :)
    integer :: from, to, step
    step = max(1, piece_numbers/size(rows, 1))
    do from = 1, size(rows, 2), step
      to = min(size(rows, 2), from + step - 1)
      call read_dataset(file, path, values, error, rows=first - 1 + [from, to])
      if (.not. allocated(error)) call check_width(file, path, size(values, 1), size(rows, 1), error)
      if (allocated(error)) return
      rows(:, from:to) = values
    end do
  end subroutine read_numbers

  subroutine check_width(file, path, found, wanted, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    integer, intent(in) :: found, wanted
    type(error_t), allocatable, intent(out) :: error
    if (found /= wanted) call raise(error, file%path//": dataset "//path//" has another shape than this program stores; " &
                                    //"it was written by another version of gimp.x")
  end subroutine check_width

end module gimp_engine_store
