!> The history of a run: one table in `/history`, a dataset per column, and the same as a CSV file on request.
!>
!> Rows gather in memory and are committed with `commit_history`, or by themselves when many have gathered. The attribute `rows`
!> of `/history` is their committed number; columns never differ in length. All ranks know the same rows; rank 0 writes the CSV file.
module gimp_history
  use gimp_common_kinds, only: dp, i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: text_of
  use gimp_parcel, only: parcel_t, carry
  use gimp_ranks, only: this_rank
  use gimp_over_ranks, only: share_error
  use gimp_file_system, only: raw_file_t, open_raw_file, resize_raw_file, close_raw_file, file_bytes
  use gimp_append_file, only: make_group, make_table, append_rows, set_attribute, stored_real64
  use gimp_output_file, only: output_file_t, commit_output
  implicit none(type, external)
  private
  public :: history_t, open_history, append_row, commit_history, close_history, carry_history, reopen_csv

  integer, parameter :: most_rows = 1024 !! gathered in memory
  integer(i8), parameter :: chunk_rows = 512

  !> The columns, and the rows not yet committed
  type :: history_t
    integer :: columns = 0
    integer(i8) :: rows = 0 !! so far, committed or not
    integer, private :: gathered = 0
    integer, allocatable, private :: table(:)
    real(dp), allocatable, private :: row(:, :) ! (row, column)
    integer, private :: csv = 0 ! unit on rank 0, 0 for none
    character(len=:), allocatable, private :: csv_path ! on all ranks if there is one
    integer(i8) :: csv_bytes = 0 !! length of the CSV file as of the last commit
  end type history_t

contains

  !> Announce the columns
  subroutine open_history(output, names, units, history, error, csv)
    type(output_file_t), intent(inout) :: output
    character(len=*), intent(in) :: names(:) !! each once, without "/" and ","
    character(len=*), intent(in) :: units(:) !! "1" for pure numbers; stored as the attribute `unit`
    type(history_t), intent(out) :: history
    type(error_t), allocatable, intent(out) :: error
    character(len=*), intent(in), optional :: csv !! path of a CSV file, which is replaced
    integer :: k
    if (size(names) /= size(units) .or. size(names) == 0) then
      call raise(error, "history: "//text_of(size(names))//" names and "//text_of(size(units))//" units of columns")
      return
    end if
    call make_group(output%file, "history", error)
    if (.not. allocated(error)) call set_attribute(output%file, "history", "rows", 0, error)
    if (allocated(error)) return
    history%columns = size(names)
    allocate (history%table(size(names)), history%row(most_rows, size(names)))
    do k = 1, size(names)
      if (scan(trim(names(k)), "/,") > 0 .or. len_trim(names(k)) == 0) then
        call raise(error, "history: a column cannot be called '"//trim(names(k))//"'")
        return
      end if
      call make_table(output%file, "history/"//trim(names(k)), stored_real64, 1, chunk_rows, history%table(k), error)
      if (.not. allocated(error)) call set_attribute(output%file, "history/"//trim(names(k)), "unit", trim(units(k)), error)
      if (allocated(error)) return
    end do
    if (.not. present(csv)) return
    if (this_rank == 0) call open_csv(history, csv, names, error)
    call share_error(error)
    if (.not. allocated(error)) history%csv_path = csv
  end subroutine open_history

  !> Rank 0 makes the CSV file
  subroutine open_csv(history, path, names, error)
    type(history_t), intent(inout) :: history
    character(len=*), intent(in) :: path, names(:)
    type(error_t), allocatable, intent(out) :: error
    character(len=200) :: reason
    integer :: status, k
    reason = ""
    open (newunit=history%csv, file=path, status="replace", action="write", iostat=status, iomsg=reason)
    if (status /= 0) then
      history%csv = 0
      call raise(error, path//": cannot be created: "//trim(reason))
      return
    end if
    write (history%csv, "(*(a))", iostat=status, iomsg=reason) (trim(names(k)), trim(merge(", ", "  ", k < size(names))), &
      k=1, size(names))
    if (status == 0) flush (history%csv, iostat=status, iomsg=reason)
    if (status /= 0) call raise(error, path//": "//trim(reason))
  end subroutine open_csv

  !> Add a row; nothing is written until rows are committed
  subroutine append_row(output, history, values, error)
    type(output_file_t), intent(inout) :: output
    type(history_t), intent(inout) :: history
    real(dp), intent(in) :: values(:) !! in the order of the columns
    type(error_t), allocatable, intent(out) :: error
    if (size(values) /= history%columns) then
      call raise(error, "history: a row has "//text_of(size(values))//" values for "//text_of(history%columns)//" columns")
      return
    end if
    if (history%gathered == most_rows) call commit_history(output, history, error)
    if (allocated(error)) return
    history%gathered = history%gathered + 1
    history%rows = history%rows + 1
    history%row(history%gathered, :) = values
  end subroutine append_row

  !> Write the gathered rows and commit; with nothing gathered nothing happens
  subroutine commit_history(output, history, error)
    type(output_file_t), intent(inout) :: output
    type(history_t), intent(inout) :: history
    type(error_t), allocatable, intent(out) :: error
    integer :: k
    if (history%gathered == 0) return
    do k = 1, history%columns
      call append_rows(output%file, history%table(k), history%row(:history%gathered, k), error)
      if (allocated(error)) return
    end do
    call set_attribute(output%file, "history", "rows", history%rows, error)
    if (.not. allocated(error)) call commit_output(output, error)
    if (.not. allocated(error) .and. allocated(history%csv_path)) then
      if (this_rank == 0) call write_csv(history, error)
      call share_error(error)
    end if
    if (.not. allocated(error)) history%gathered = 0
  end subroutine commit_history

  subroutine write_csv(history, error)
    type(history_t), intent(in) :: history
    type(error_t), allocatable, intent(out) :: error
    character(len=:), allocatable :: line
    character(len=32) :: number
    character(len=200) :: reason
    integer :: i, k, status
    reason = ""
    status = 0
    do i = 1, history%gathered
      line = ""
      do k = 1, history%columns
        write (number, "(es24.16e3)") history%row(i, k) ! 17 digits: the same number when read back
        line = line//trim(adjustl(number))
        if (k < history%columns) line = line//","
      end do
      if (status == 0) write (history%csv, "(a)", iostat=status, iomsg=reason) line
    end do
    if (status == 0) flush (history%csv, iostat=status, iomsg=reason)
    if (status /= 0) call raise(error, history%csv_path//": "//trim(reason))
  end subroutine write_csv

  !> Commit what is left and close the CSV file; the output file stays open
  subroutine close_history(output, history, error)
    type(output_file_t), intent(inout) :: output
    type(history_t), intent(inout) :: history
    type(error_t), allocatable, intent(out) :: error
    type(error_t), allocatable :: problem
    integer :: status
    call commit_history(output, history, error)
    if (.not. allocated(history%csv_path)) return
    status = 0
    if (history%csv /= 0) close (history%csv, iostat=status)
    history%csv = 0
    if (status /= 0) call raise(problem, history%csv_path//": closing failed; is the disk full?")
    call share_error(problem)
    if (allocated(problem) .and. .not. allocated(error)) call move_alloc(problem, error)
    deallocate (history%csv_path)
  end subroutine close_history

  !> Pack or unpack what is known of a history without gathered rows; the CSV file has to be opened by `reopen_csv`. Only rank 0
  !> knows the length of the CSV file: what it packs counts
  subroutine carry_history(history, parcel)
    type(history_t), intent(inout) :: history
    type(parcel_t), intent(inout) :: parcel
    integer :: k
    call carry(parcel, history%columns)
    call carry(parcel, history%rows)
    if (parcel%reading .and. parcel%sound) allocate (history%table(history%columns), history%row(most_rows, history%columns))
    do k = 1, history%columns
      if (.not. parcel%sound) return
      call carry(parcel, history%table(k))
    end do
    if (history%csv /= 0) history%csv_bytes = file_bytes(history%csv_path)
    call carry(parcel, history%csv_bytes)
  end subroutine carry_history

  !> Cut a CSV file back to the length it had when the history was packed, and go on with it
  subroutine reopen_csv(history, path, error)
    type(history_t), intent(inout) :: history
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(out) :: error
    if (this_rank == 0) call cut_csv(history, path, error)
    call share_error(error)
    if (.not. allocated(error)) history%csv_path = path
  end subroutine reopen_csv

  subroutine cut_csv(history, path, error)
    type(history_t), intent(inout) :: history
    character(len=*), intent(in) :: path
    type(error_t), allocatable, intent(out) :: error
    type(raw_file_t) :: raw
    character(len=200) :: reason
    integer :: status
    call open_raw_file(path, raw, error)
    if (.not. allocated(error)) call resize_raw_file(raw, history%csv_bytes, error)
    if (.not. allocated(error)) call close_raw_file(raw, error)
    if (allocated(error)) return
    reason = ""
    open (newunit=history%csv, file=path, status="old", position="append", action="write", iostat=status, iomsg=reason)
    if (status == 0) return
    history%csv = 0
    call raise(error, path//": cannot be continued: "//trim(reason))
  end subroutine cut_csv

end module gimp_history
