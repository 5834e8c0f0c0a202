!> Rows of the tables of an append-only file: the same on all ranks, or a slab from each
module gimp_append_rows
  use, intrinsic :: iso_c_binding, only: c_loc
  use, intrinsic :: iso_fortran_env, only: real32
  use, intrinsic :: ieee_arithmetic, only: ieee_value, ieee_positive_inf, ieee_negative_inf, ieee_quiet_nan
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_ranks, only: this_rank
  use gimp_hdf5_format, only: bytes_t, stored_real32, stored_real64, stored_int64, undefined_address, node_width
  use gimp_append_index, only: row_bytes, put_leaf
  use gimp_append_state, only: append_file_t, check_usable, take_room, put_on_disk, put_bytes, push
  implicit none(type, external)
  private
  public :: append_rows, append_slab, table_rows

  !> Add rows at the end of a table that all ranks know: values(rows) for one component, else values(components, rows)
  interface append_rows
    module procedure append_real, append_reals, append_long, append_longs
  end interface append_rows

  !> Add `rows` rows at the end of a table, of which this rank has those after the first `before`: shapes as in `append_rows`.
  !> All ranks call it, also those without rows; each row comes from one rank.
  interface append_slab
    module procedure slab_real, slab_reals, slab_long
  end interface append_slab

contains

  !> Rows of a table, committed or not
  pure integer(i8) function table_rows(file, table)
    type(append_file_t), intent(in) :: file
    integer, intent(in) :: table
    table_rows = file%object(table)%rows
  end function table_rows

  subroutine append_real(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:)
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, 1, writes(size(values, kind=i8)), values, 0_i8, size(values, kind=i8), error)
  end subroutine append_real

  subroutine append_reals(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:, :)
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, size(values, 1), writes(size(values, 2, kind=i8)), values, 0_i8, size(values, 2, kind=i8), error)
  end subroutine append_reals

  subroutine append_long(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in), contiguous :: values(:)
    type(error_t), allocatable, intent(out) :: error
    call append_long_rows(file, table, 1, writes(size(values, kind=i8)), values, 0_i8, size(values, kind=i8), error)
  end subroutine append_long

  subroutine append_longs(file, table, values, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in), contiguous :: values(:, :)
    type(error_t), allocatable, intent(out) :: error
    call append_long_rows(file, table, size(values, 1), writes(size(values, 2, kind=i8)), values, 0_i8, size(values, 2, kind=i8), error)
  end subroutine append_longs

  !> Of rows that all ranks know: those that this one writes
  integer(i8) function writes(rows)
    integer(i8), intent(in) :: rows
    writes = merge(rows, 0_i8, this_rank == 0)
  end function writes

  subroutine slab_real(file, table, values, before, rows, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:)
    integer(i8), intent(in) :: before, rows
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, 1, size(values, kind=i8), values, before, rows, error)
  end subroutine slab_real

  subroutine slab_reals(file, table, values, before, rows, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    real(dp), intent(in), contiguous :: values(:, :)
    integer(i8), intent(in) :: before, rows
    type(error_t), allocatable, intent(out) :: error
    call append_real_rows(file, table, size(values, 1), size(values, 2, kind=i8), values, before, rows, error)
  end subroutine slab_reals

  subroutine slab_long(file, table, values, before, rows, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in), contiguous :: values(:)
    integer(i8), intent(in) :: before, rows
    type(error_t), allocatable, intent(out) :: error
    call append_long_rows(file, table, 1, size(values, kind=i8), values, before, rows, error)
  end subroutine slab_long

  subroutine append_real_rows(file, table, components, mine, values, before, rows, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table, components
    integer(i8), intent(in) :: mine !! rows that this rank writes
    real(dp), intent(in), target :: values(components, mine)
    integer(i8), intent(in) :: before !! rows of other ranks before them
    integer(i8), intent(in) :: rows !! of all ranks
    type(error_t), allocatable, intent(out) :: error
    real(real32), allocatable, target :: narrow(:, :)
    integer(i8) :: done, m, first, last, address

    call check_table(file, table, components, [stored_real32, stored_real64], error)
    if (allocated(error)) return
    done = 0
    do while (done < rows)
      call next_room(file, table, rows - done, m, address)
      call own_part(file, table, done, m, before, mine, address, first, last)
      if (last >= first) then
        if (file%object(table)%stored == stored_real32) then
          narrow = single_of(values(:, first:last))
          call put_bytes(file, address, c_loc(narrow), 4*components*(last - first + 1))
        else
          call put_bytes(file, address, c_loc(values(1, first)), 8*components*(last - first + 1))
        end if
      end if
      done = done + m
    end do
  end subroutine append_real_rows

  subroutine append_long_rows(file, table, components, mine, values, before, rows, error)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table, components
    integer(i8), intent(in) :: mine !! rows that this rank writes
    integer(i8), intent(in), target :: values(components, mine)
    integer(i8), intent(in) :: before !! rows of other ranks before them
    integer(i8), intent(in) :: rows !! of all ranks
    type(error_t), allocatable, intent(out) :: error
    integer(i8) :: done, m, first, last, address

    call check_table(file, table, components, [stored_int64], error)
    if (allocated(error)) return
    done = 0
    do while (done < rows)
      call next_room(file, table, rows - done, m, address)
      call own_part(file, table, done, m, before, mine, address, first, last)
      if (last >= first) call put_bytes(file, address, c_loc(values(1, first)), 8*components*(last - first + 1))
      done = done + m
    end do
  end subroutine append_long_rows

  !> Which of this rank's rows are among the `m` rows after the first `done` of all ranks, and where they go
  pure subroutine own_part(file, table, done, m, before, mine, address, first, last)
    type(append_file_t), intent(in) :: file
    integer, intent(in) :: table
    integer(i8), intent(in) :: done, m, before, mine
    integer(i8), intent(inout) :: address !! in: of the first of the m rows; out: of this rank's first one
    integer(i8), intent(out) :: first, last !! from 1; last < first for none
    first = max(done - before, 0_i8) + 1
    last = min(done + m - before, mine)
    address = address + (before + first - 1 - done)*row_bytes(file%object(table))
  end subroutine own_part

  !> Give room to the next rows of a table, as many as fit in one place; opens a chunk when the last one is full
  subroutine next_room(file, table, wanted, m, address)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    integer(i8), intent(in) :: wanted
    integer(i8), intent(out) :: m
    integer(i8), intent(out) :: address !! in the file
    integer(i8), parameter :: piece = 2_i8**20 ! bytes converted at a time, so that a frame needs no copy of its own
    integer(i8) :: within, new
    within = mod(file%object(table)%rows, file%object(table)%chunk_rows)
    if (file%object(table)%rows == file%object(table)%chunks*file%object(table)%chunk_rows) then
      call take_room(file, file%object(table)%chunk_rows*row_bytes(file%object(table)), new)
      associate (o => file%object(table))
        call push(o%chunk, o%chunks, new)
        o%chunks = o%chunks + 1
      end associate
      if (mod(file%object(table)%chunks, int(node_width, i8)) == 0) call write_full_leaf(file, table)
    end if
    associate (o => file%object(table))
      m = min(wanted, o%chunk_rows - within, max(1_i8, piece/row_bytes(o)))
      address = o%chunk(o%chunks) + within*row_bytes(o)
    end associate
    file%object(table)%rows = file%object(table)%rows + m
  end subroutine next_room

  !> An index leaf that is full never changes again: it is written once, where it stays.
  !> Its right neighbour is not known yet and left open; searches go from the root down and do not need it.
  subroutine write_full_leaf(file, table)
    type(append_file_t), intent(inout) :: file
    integer, intent(in) :: table
    type(bytes_t) :: node
    integer(i8) :: address, first, left
    first = file%object(table)%chunks - node_width
    left = undefined_address
    if (first > 0) left = file%object(table)%leaf(file%object(table)%leaves)
    call put_leaf(node, file%object(table), first, left)
    call take_room(file, int(node%n, i8), address)
    associate (o => file%object(table))
      call push(o%leaf, o%leaves, address)
      o%leaves = o%leaves + 1
    end associate
    call put_on_disk(file, address, node%data(:node%n))
  end subroutine write_full_leaf

  subroutine check_table(file, table, components, kinds, error)
    type(append_file_t), intent(in) :: file
    integer, intent(in) :: table, components, kinds(:)
    type(error_t), allocatable, intent(out) :: error
    call check_usable(file, error)
    if (allocated(error)) return
    associate (o => file%object(table))
      if (components /= o%components) then
        call raise(error, file%path//": table "//o%name//" has "//text_of(o%components)//" components, got " &
          //text_of(components))
      else if (all(kinds /= o%stored)) then
        call raise(error, file%path//": table "//o%name//" holds the other kind of number (real or integer)")
      end if
    end associate
  end subroutine check_table

  !> Single precision; what is too large becomes infinite, without raising a floating-point exception
  elemental real(real32) function single_of(value)
    real(dp), intent(in) :: value
    if (value /= value) then ! first, because other comparisons with NaN raise an exception
      single_of = ieee_value(single_of, ieee_quiet_nan)
    else if (abs(value) <= real(huge(1.0_real32), dp)) then
      single_of = real(value, real32)
    else if (value > 0.0_dp) then
      single_of = ieee_value(single_of, ieee_positive_inf)
    else
      single_of = ieee_value(single_of, ieee_negative_inf)
    end if
  end function single_of

end module gimp_append_rows
