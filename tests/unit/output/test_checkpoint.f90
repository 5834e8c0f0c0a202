!> Checkpoint files: two are kept, damage is told with the name of the other one, and they know their output file again
program test_checkpoint
  use gimp_common_kinds, only: i8
  use gimp_error, only: error_t, raise
  use gimp_text, only: count_words, nth_word
  use gimp_file_system, only: delete_file, file_exists
  use gimp_ranks, only: this_rank, start_ranks, end_ranks, wait_for_ranks
  use gimp_shared_hdf5, only: shared_file_t, announce_rows, end_layout, write_rows
  use gimp_hdf5, only: hdf5_file_t, open_hdf5, close_hdf5, read_attribute, write_attribute
  use gimp_checkpoint, only: newest_path, older_path, begin_checkpoint, end_checkpoint, drop_checkpoint, open_checkpoint, twin_of, &
    longer_lineage, check_lineage
  use gimp_check, only: begin_suite, end_suite, check, check_true
  implicit none(type, external)
  character(len=*), parameter :: name = "test_checkpoint", newest = name//".checkpoint.h5", older = name//".checkpoint.old.h5", &
    output = name//".vtkhdf"
  type(error_t), allocatable :: error
  call start_ranks()
  call begin_suite("checkpoint")
  call clear()
  call two_are_kept()
  call the_other_is_named()
  call a_rank_fails()
  call lineage()
  call clear()
  call end_suite()
  call end_ranks(0)

contains

  subroutine clear()
    call wait_for_ranks()
    if (this_rank == 0) then
      call delete_file(newest, error)
      call delete_file(older, error)
      call delete_file(output, error)
    end if
    call wait_for_ranks()
  end subroutine clear

  subroutine keep(step, keep_present)
    integer, intent(in) :: step
    logical, intent(in) :: keep_present
    type(shared_file_t) :: shared
    call begin_checkpoint(name, shared, error)
    if (this_rank == 0) call write_attribute(shared%file, "", "step", step, error)
    call announce_rows(shared, "rows", "int64", 2_i8)
    call end_layout(shared, error)
    call write_rows(shared, "rows", 1_i8, [1_i8, 2_i8], error)
    call end_checkpoint(name, keep_present, shared, error)
    call check_true(.not. allocated(error), "a checkpoint is written")
  end subroutine keep

  !> Step of a checkpoint, -1 if it is not sound
  integer function step_of(path)
    character(len=*), intent(in) :: path
    type(hdf5_file_t) :: file
    integer(i8) :: step
    step_of = -1
    call open_checkpoint(path, file, error)
    if (allocated(error)) return
    call read_attribute(file, "", "step", step, error)
    step_of = int(step)
    call close_hdf5(file, error)
  end function step_of

  subroutine two_are_kept()
    type(shared_file_t) :: shared
    call check(newest_path(name), newest, "name of the newest")
    call check(older_path(name), older, "name of the older one")
    call keep(10, .true.)
    call check_true(.not. file_exists(older), "at first there is one")
    call keep(20, .true.)
    call check(step_of(newest), 20, "the newest")
    call check(step_of(older), 10, "the one before")
    call keep(30, .true.)
    call check(step_of(newest), 30, "the newest of three")
    call check(step_of(older), 20, "the one before of three")
    call keep(40, .false.)
    call check(step_of(newest), 40, "in place of one that is worth nothing")
    call check(step_of(older), 20, "while the older one stays")
    call begin_checkpoint(name, shared, error)
    call drop_checkpoint(name, shared)
    call wait_for_ranks()
    call check(step_of(newest), 40, "one that cannot be finished harms nobody")
    call check_true(.not. file_exists(newest//".part"), "and leaves nothing")
  end subroutine two_are_kept

  subroutine the_other_is_named()
    integer :: unit
    call check(twin_of(newest), "; "//older//" is whole (step 20)", "the other of the newest")
    call check(twin_of(older), "; "//newest//" is whole (step 40)", "the other of the older one")
    call check(twin_of("elsewhere.h5"), "", "a name of one's own has none")
    if (this_rank == 0) then
      open (newunit=unit, file=newest, access="stream", form="unformatted", action="readwrite", status="old")
      write (unit, pos=600) "x"
      close (unit)
    end if
    call wait_for_ranks()
    call check(step_of(newest), -1, "damage is noticed")
    call check(error%message, newest//": is damaged: its checksum is wrong", "and told")
    call check(twin_of(older), "", "what is damaged is not named")
  end subroutine the_other_is_named

  !> What one rank could not write leaves the checkpoints as they are
  subroutine a_rank_fails()
    type(shared_file_t) :: shared
    call keep(50, .false.)
    call begin_checkpoint(name, shared, error)
    if (this_rank == 0) call write_attribute(shared%file, "", "step", 60, error)
    call announce_rows(shared, "rows", "int64", 2_i8)
    call end_layout(shared, error)
    if (this_rank == 0) call raise(error, "the disk of the first rank is full")
    call end_checkpoint(name, .true., shared, error)
    call check_true(allocated(error), "all ranks know")
    call check(error%message, "the disk of the first rank is full", "and can say why")
    call drop_checkpoint(name, shared)
    call check(step_of(newest), 50, "the newest stays")
    call check(step_of(older), 20, "and the older one")
  end subroutine a_rank_fails

  subroutine lineage()
    character(len=:), allocatable :: first, second, long
    integer :: k
    first = longer_lineage("", 0_i8)
    second = longer_lineage(first, 50_i8)
    call check(count_words(second), 2, "each run adds an entry")
    call check(nth_word(second, 1), first, "to what it continues")
    call check_true(nth_word(second, 2) /= first(:16)//"@50" .and. index(second, "@50") > 0, "with a token of its own")
    call check_true(.not. fits(first, 0), "no output file")
    call sign(first)
    call check_true(fits(first, 100), "the file of the run")
    call check_true(.not. fits(longer_lineage("", 0_i8), 0), "another run")
    call sign(second)
    call check_true(fits(second, 70), "the continued file and a checkpoint of then")
    call check_true(fits(first, 50), "or the one it was continued from")
    call check_true(fits(first, 30), "or one before that")
    call check_true(.not. fits(first, 70), "but none of what was cut off")
    call check_true(index(error%message, "was continued from step 50 since") > 0, "which is told")
    long = first
    do k = 1, 1300
      long = longer_lineage(long, int(k, i8))
    end do
    call check_true(len(long) <= 32768, "a lineage fits into an attribute")
    call sign(long)
    call check_true(fits(long, 3000), "and the latest entries count")
  end subroutine lineage

  subroutine sign(lineage)
    character(len=*), intent(in) :: lineage
    type(hdf5_file_t) :: file
    if (this_rank == 0) then
      call open_hdf5(output, "overwrite", file, error)
      call write_attribute(file, "", "lineage", lineage, error)
      call close_hdf5(file, error)
    end if
    call wait_for_ranks()
  end subroutine sign

  logical function fits(lineage, step)
    character(len=*), intent(in) :: lineage
    integer, intent(in) :: step
    call check_lineage(output, lineage, int(step, i8), error)
    fits = .not. allocated(error)
  end function fits

end program test_checkpoint
