!> Checkpoint files: how they are named, written aside, sealed and kept, and which output file they belong to.
!>
!> A checkpoint is an HDF5 file with a seal over all its bytes, written by all ranks. It is written under another name, waited for,
!> and renamed; the one before is kept. What is in it is the business of `gimp_restart`.
module gimp_checkpoint
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of, count_words, nth_word
  use gimp_hash_table, only: mix_bits
  use gimp_parcel, only: parcel_t, unpack_parcel
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: share_error
  use gimp_file_system, only: rename_file, delete_file, file_exists
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_dataset, write_dataset, read_attribute, has_attribute
  use gimp_shared_hdf5, only: shared_file_t, lay_out, close_shared, drop_shared
  use gimp_sealed_file, only: seal_bytes, seal_file, check_seal
  implicit none(type, external)
  private
  public :: newest_path, older_path, begin_checkpoint, end_checkpoint, drop_checkpoint, open_checkpoint, twin_of
  public :: write_parcel, read_parcel, longer_lineage, check_lineage

  character(len=*), parameter :: kind = "gimp.x checkpoint"
  integer, parameter :: version = 5 !! of the format: one more with every change that an older program would misread
  character(len=*), parameter :: newest_end = ".checkpoint.h5", older_end = ".checkpoint.old.h5"
  integer, parameter :: longest_lineage = 30000 !! characters; older entries are forgotten

contains

  !> Path of the newest checkpoint of a run
  pure function newest_path(name) result(path)
    character(len=*), intent(in) :: name !! NAME of &output
    character(len=:), allocatable :: path
    path = name//newest_end
  end function newest_path

  !> Path of the one before
  pure function older_path(name) result(path)
    character(len=*), intent(in) :: name
    character(len=:), allocatable :: path
    path = name//older_end
  end function older_path

  !> Start to lay out a checkpoint under a name aside. Collective
  subroutine begin_checkpoint(name, shared, error)
    character(len=*), intent(in) :: name
    type(shared_file_t), intent(out) :: shared
    type(error_t), allocatable, intent(out) :: error
    call lay_out(newest_path(name)//".part", shared, error, user_block=seal_bytes)
  end subroutine begin_checkpoint

  !> Seal what all ranks have written and give it its name; the present newest becomes the older one, unless it is worth nothing.
  !> `error` may come in from one rank: then nothing is renamed. Collective
  subroutine end_checkpoint(name, keep_present, shared, error)
    character(len=*), intent(in) :: name
    logical, intent(in) :: keep_present
    type(shared_file_t), intent(inout) :: shared
    type(error_t), allocatable, intent(inout) :: error
    character(len=:), allocatable :: newest
    newest = newest_path(name)
    call close_shared(shared, error)
    if (.not. allocated(error)) call seal_file(newest//".part", kind, version, error)
    if (allocated(error)) return
    if (this_rank == 0) then
      if (file_exists(newest) .and. keep_present) call rename_file(newest, older_path(name), error)
      if (.not. allocated(error)) call rename_file(newest//".part", newest, error)
    end if
    call share_error(error)
  end subroutine end_checkpoint

  !> Take away what could not be finished. All ranks have the error that says so
  subroutine drop_checkpoint(name, shared)
    character(len=*), intent(in) :: name
    type(shared_file_t), intent(inout) :: shared
    type(error_t), allocatable :: ignored
    call drop_shared(shared)
    if (this_rank == 0) call delete_file(newest_path(name)//".part", ignored)
  end subroutine drop_checkpoint

  !> Open a checkpoint for reading, after a look at every byte of it. Collective
  subroutine open_checkpoint(path, file, error)
    character(len=*), intent(in) :: path
    type(hdf5_file_t), intent(out) :: file
    type(error_t), allocatable, intent(out) :: error
    call check_seal(path, kind, version, error)
    if (allocated(error)) return
    call open_hdf5(path, "read", file, error)
    call share_error(error)
  end subroutine open_checkpoint

  !> The other of the two checkpoints that are kept, if it is whole: "; PATH is whole (step N)". Else nothing. Collective
  function twin_of(path) result(words)
    character(len=*), intent(in) :: path
    character(len=:), allocatable :: words, twin
    type(hdf5_file_t) :: file
    type(error_t), allocatable :: error
    integer(i8) :: step
    integer :: n
    words = ""
    n = len(path)
    if (ends_with(newest_end)) then
      twin = older_path(path(:n - len(newest_end)))
    else if (ends_with(older_end)) then
      twin = newest_path(path(:n - len(older_end)))
    else
      return
    end if
    call open_checkpoint(twin, file, error)
    if (.not. allocated(error)) call read_attribute(file, "", "step", step, error)
    call share_error(error)
    if (.not. allocated(error)) words = "; "//twin//" is whole (step "//text_of(step)//")"
    call close_hdf5(file, error)

  contains

    logical function ends_with(end)
      character(len=*), intent(in) :: end
      ends_with = .false.
      if (n > len(end)) ends_with = path(n - len(end) + 1:) == end
    end function ends_with

  end function twin_of

  !> Store packed state as a dataset
  subroutine write_parcel(file, path, parcel, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    type(parcel_t), intent(in) :: parcel
    type(error_t), allocatable, intent(out) :: error
    call write_dataset(file, path, parcel%words(:parcel%n), error)
  end subroutine write_parcel

  !> Take packed state out of a dataset
  subroutine read_parcel(file, path, parcel, error)
    type(hdf5_file_t), intent(in) :: file
    character(len=*), intent(in) :: path
    type(parcel_t), intent(out) :: parcel
    type(error_t), allocatable, intent(out) :: error
    integer(i8), allocatable :: words(:)
    call read_dataset(file, path, words, error)
    if (.not. allocated(error)) call unpack_parcel(parcel, words)
  end subroutine read_parcel

  !> Who wrote an output file: "TOKEN@0 TOKEN@STEP ...", one entry for each run that wrote to it and the step from which on.
  !> A new run adds itself to what it continues (nothing at the start).
  function longer_lineage(before, step) result(lineage)
    character(len=*), intent(in) :: before
    integer(i8), intent(in) :: step
    character(len=:), allocatable :: lineage
    character(len=16) :: token
    integer :: now(8)
    integer(i8) :: count
    call system_clock(count)
    call date_and_time(values=now)
    write (token, "(z16.16)") ieor(mix_bits(count), mix_bits(transfer(now(5:8:3), 0_i8)))
    lineage = token//"@"//text_of(step)
    if (before == "") return
    lineage = before//" "//lineage
    do while (len(lineage) > longest_lineage)
      lineage = lineage(index(lineage, " ") + 1:)
    end do
  end function longer_lineage

  !> Whether an output file still begins with what it held when a checkpoint was written. Collective
  subroutine check_lineage(path, lineage, step, error)
    character(len=*), intent(in) :: path !! of the output file
    character(len=*), intent(in) :: lineage !! as the checkpoint has it
    integer(i8), intent(in) :: step !! of the checkpoint
    type(error_t), allocatable, intent(out) :: error
    if (this_rank == 0) call compare_lineage(path, lineage, step, error)
    call share_error(error)
  end subroutine check_lineage

  subroutine compare_lineage(path, lineage, step, error)
    character(len=*), intent(in) :: path, lineage
    integer(i8), intent(in) :: step
    type(error_t), allocatable, intent(out) :: error
    type(hdf5_file_t) :: file
    type(error_t), allocatable :: ignored
    character(len=:), allocatable :: present, entry
    integer(i8) :: from
    integer :: k, status
    if (.not. file_exists(path)) then
      call raise(error, path//" is missing; the output of the run must be there to be continued")
      return
    end if
    call open_hdf5(path, "read", file, error)
    if (allocated(error)) return
    present = ""
    if (has_attribute(file, "", "lineage")) call read_attribute(file, "", "lineage", present, error)
    call close_hdf5(file, ignored)
    if (allocated(error)) return
    do k = 1, count_words(present)
      if (nth_word(present, k) == nth_word(lineage, count_words(lineage))) exit
    end do
    if (k > count_words(present)) then
      call raise(error, path//" is not the output file that this checkpoint belongs to")
    else if (k < count_words(present)) then
      entry = nth_word(present, k + 1)
      read (entry(index(entry, "@") + 1:), *, iostat=status) from
      if (status /= 0) from = 0
      if (from < step) call raise(error, path//" was continued from step "//text_of(from) &
                                  //" since; only checkpoints of that run or up to that step fit it")
    end if
  end subroutine compare_lineage

end module gimp_checkpoint
