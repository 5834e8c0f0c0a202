!> What working together costs: balance of work, halo, messages and waits of all ranks, for the closing table and /summary.
!> All of it since this program started.
module gimp_ranks_report
  use gimp_kinds, only: dp, i8
  use gimp_error, only: error_t
  use gimp_text, only: text_of, with_thousands, short_number
  use gimp_file_system, only: peak_memory
  use gimp_ranks, only: ranks
  use gimp_traffic, only: traffic, of_pads, of_lists, of_all
  use gimp_over_ranks, only: sum_counts, largest_count, largest_reals
  use gimp_output_file, only: output_file_t
  use gimp_summary, only: put_summary
  use gimp_run_state, only: stepper_t
  implicit none(type, external)
  private
  public :: together_t, measure_together, together_words, write_together

  !> Sums over ranks unless it says otherwise
  type :: together_t
    real(dp) :: imbalance = 1.0_dp, worst = 1.0_dp !! largest counted work of a rank over the mean: after the last sort, and ever
    real(dp) :: crowding = 1.0_dp, worst_crowding = 1.0_dp !! the same of particles
    integer(i8) :: repartitions = 0
    integer(i8) :: moved_bytes = 0, migrated = 0, migrated_bytes = 0 !! of blocks handed over; particles that changed their rank
    integer(i8) :: pad_messages = 0, pad_bytes = 0
    integer(i8) :: list_messages = 0, list_bytes = 0
    integer(i8) :: reductions = 0 !! of one rank, as all take part in each
    real(dp) :: halo = 0.0_dp !! ghosts per block of its own, of the rank where that is largest
    real(dp) :: waited(3) = 0.0_dp !! for pads, lists and what all share: longest of a rank [s]
    integer(i8) :: memory = 0 !! most that a rank has held [bytes]; 0 where the system does not tell
  end type together_t

contains

  !> Gather the figures of all ranks. Collective
  subroutine measure_together(s, together)
    type(stepper_t), intent(in) :: s
    type(together_t), intent(out) :: together
    real(dp) :: most(4)
    integer(i8) :: pads(2), lists(2), all
    pads = [traffic(of_pads)%messages, traffic(of_pads)%words]
    lists = [traffic(of_lists)%messages, traffic(of_lists)%words]
    all = traffic(of_all)%calls
    most = [traffic%seconds, real(s%engine%table%ghosts, dp)/max(1, s%engine%table%blocks)]
    together%memory = largest_count(peak_memory())
    together%reductions = all
    together%pad_messages = sum_counts(pads(1))
    together%pad_bytes = 8*sum_counts(pads(2))
    together%list_messages = sum_counts(lists(1))
    together%list_bytes = 8*sum_counts(lists(2))
    together%migrated = sum_counts(s%engine%border%migrated)
    together%migrated_bytes = 8*sum_counts(s%engine%border%migrated_words)
    together%moved_bytes = 8*sum_counts(s%engine%border%moved_words)
    together%repartitions = s%engine%border%repartitions
    together%imbalance = s%engine%border%imbalance
    together%worst = s%engine%border%worst_imbalance
    together%crowding = s%engine%border%crowding
    together%worst_crowding = s%engine%border%worst_crowding
    call largest_reals(most)
    together%waited = most(:3)
    together%halo = most(4)
  end subroutine measure_together

  !> Lines for the closing table, separated by new lines; nothing for one rank
  function together_words(together, all_seconds, steps) result(words)
    type(together_t), intent(in) :: together
    real(dp), intent(in) :: all_seconds !! set-up, stepping and output [s]
    integer(i8), intent(in) :: steps !! taken by this program
    character(len=:), allocatable :: words
    words = ""
    if (ranks == 1) return
    words = "  balance            largest work of a rank "//text_of(together%imbalance, 3)//" times the mean ("//text_of(together%worst, 3) &
      //" at worst); "//with_thousands(together%repartitions)//" repartitions, "//with_thousands(together%migrated) &
      //" particles changed their rank"//new_line("a") &
      //"  pads               "//short_number(real(together%pad_bytes, dp)/max(1_i8, steps))//"B in " &
      //text_of(real(together%pad_messages, dp)/max(1_i8, steps), 3)//" messages a step of all ranks; up to " &
      //text_of(together%halo, 2)//" ghosts a block; repartition "//short_number(real(together%moved_bytes, dp))//"B in all"//new_line("a") &
      //"  waited             pads "//share(1)//", lists "//share(2)//", reductions "//share(3)//" of the run on the rank that waits most" &
      //new_line("a")//"  memory             "//short_number(real(together%memory, dp))//"B at most on a rank"

  contains

    function share(k) result(text)
      integer, intent(in) :: k
      character(len=:), allocatable :: text
      text = text_of(nint(100.0_dp*together%waited(k)/max(all_seconds, 1.0e-9_dp)))//" %"
    end function share

  end function together_words

  !> The same as attributes of /summary
  subroutine write_together(output, together, error)
    type(output_file_t), intent(inout) :: output
    type(together_t), intent(in) :: together
    type(error_t), allocatable, intent(inout) :: error
    call number("imbalance", together%imbalance)
    call number("imbalance_worst", together%worst)
    call number("imbalance_particles", together%crowding)
    call number("imbalance_particles_worst", together%worst_crowding)
    call count("repartitions", together%repartitions)
    call count("repartition_bytes", together%moved_bytes)
    call count("migrated_particles", together%migrated)
    call count("migrated_bytes", together%migrated_bytes)
    call count("pad_messages", together%pad_messages)
    call count("pad_bytes", together%pad_bytes)
    call count("list_messages", together%list_messages)
    call count("list_bytes", together%list_bytes)
    call count("reductions", together%reductions)
    call number("halo_share", together%halo)
    call number("seconds_pads", together%waited(1))
    call number("seconds_lists", together%waited(2))
    call number("seconds_reductions", together%waited(3))
    call count("memory_peak_bytes", together%memory)

  contains

    subroutine number(name, value)
      character(len=*), intent(in) :: name
      real(dp), intent(in) :: value
      if (.not. allocated(error)) call put_summary(output, name, value, error)
    end subroutine number

    subroutine count(name, value)
      character(len=*), intent(in) :: name
      integer(i8), intent(in) :: value
      if (.not. allocated(error)) call put_summary(output, name, value, error)
    end subroutine count

  end subroutine write_together

end module gimp_ranks_report
