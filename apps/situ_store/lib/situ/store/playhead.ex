defmodule Situ.Store.Playhead do
  @moduledoc false
  # The playback position of one importer's streams, shared by their processes through atomics.
  #
  # An epoch is a span of replay in which pipeline time = recorded time + shift. A seek to a time after everything
  # handed out so far stays in the epoch. Any other seek begins a new epoch, so that originating times keep increasing.
  # See docs/adr/0032-replay-follows-originating-times.md.

  # Cells: 1 version (odd during a seek), 2 the recorded time of the seek, 3 the shift, 4 the latest pipeline time
  # handed out by any stream.
  @nowhere -0x7FFFFFFFFFFFFFFF
  @gap 1_000_000

  @type t :: :atomics.atomics_ref()
  @type view :: {version :: non_neg_integer(), time :: Situ.Time.t(), shift :: integer()}

  @spec new() :: t()
  def new do
    cells = :atomics.new(4, signed: true)
    :atomics.put(cells, 2, @nowhere)
    :atomics.put(cells, 4, @nowhere)
    cells
  end

  @doc "Returns the version, which changes with every seek."
  @spec seek_version(t()) :: non_neg_integer()
  def seek_version(cells), do: :atomics.get(cells, 1)

  @doc "Returns the version, time and shift of the latest seek. Waits for a seek in progress."
  @spec read_view(t()) :: view()
  def read_view(cells) do
    version = seek_version(cells)
    view = {version, :atomics.get(cells, 2), :atomics.get(cells, 3)}

    if rem(version, 2) == 0 and seek_version(cells) == version do
      view
    else
      :erlang.yield()
      read_view(cells)
    end
  end

  @doc """
  Requests to hand out messages up to pipeline time `time`. Returns `false` if a seek has intervened; the messages must
  then not be handed out.

  The claim is stored before the version is read again, and a seek reads the claims after it has changed the version. So
  at least one of the two sees the other.
  """
  @spec claim_time(t(), Situ.Time.t(), non_neg_integer()) :: boolean()
  def claim_time(cells, time, version) do
    raise_to(cells, time)
    seek_version(cells) == version
  end

  defp raise_to(cells, time) do
    reached = :atomics.get(cells, 4)

    if time > reached and :atomics.compare_exchange(cells, 4, reached, time) != :ok,
      do: raise_to(cells, time),
      else: :ok
  end

  @doc """
  Continues at recorded time `time` and returns the corresponding pipeline time. `now` is the clock time. `anew` forces
  a new epoch.
  """
  @spec seek_to(t(), Situ.Time.t(), Situ.Time.t(), boolean()) :: Situ.Time.t()
  def seek_to(cells, now, time, anew) do
    version = seek_version(cells)

    if rem(version, 2) == 1 or
         :atomics.compare_exchange(cells, 1, version, version + 1) != :ok do
      :erlang.yield()
      seek_to(cells, now, time, anew)
    else
      shift = :atomics.get(cells, 3)
      reached = max(now, :atomics.get(cells, 4))
      shift = if anew or time + shift <= reached, do: reached + @gap - time, else: shift
      :atomics.put(cells, 2, time)
      :atomics.put(cells, 3, shift)
      :atomics.put(cells, 1, version + 2)
      time + shift
    end
  end
end
