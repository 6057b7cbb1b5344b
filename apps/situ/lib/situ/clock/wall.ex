defmodule Situ.Clock.Wall do
  @moduledoc false
  # Wall time that never goes backward: the processor's counter plus an offset, which is compared with the system time
  # once a second. If they differ by more than 0.1 ms (the system time was set, or the machine was asleep), wall time
  # jumps forward when the system is ahead. Otherwise it pauses until the system has caught up.
  #
  # The VM's own system time corrects itself by running 1 % faster or slower, which takes four days for one hour.
  use GenServer

  alias Situ.Runtime

  @every_ms 1_000
  @drift 100_000
  # The maximum lead of a reading with the old offset, ns: other schedulers see the new offset slightly later.
  @margin 1_000_000
  @tries 8

  @typedoc """
  Two words: the offset of the counter, and the lowest time that a reading may return. The time of a simulation is one
  word.
  """
  @type cells :: :atomics.atomics_ref() | {:simulated, :atomics.atomics_ref()}
  @type line :: {offset :: integer(), floor :: integer()}

  @doc "Returns the cells of this node, or `nil` if no process maintains them; `now/1` then reads the system time."
  @spec shared_cells() :: cells() | nil
  def shared_cells, do: :persistent_term.get(__MODULE__, nil)

  @doc "Returns the cells that apply to the calling process: the cells of its simulation, or of the node."
  @spec current_cells() :: cells() | nil
  def current_cells, do: Runtime.wall_cells() || shared_cells()

  @doc "Returns the wall time, ns since 1970."
  @spec now(cells() | nil) :: Situ.Time.t()
  def now(nil), do: :os.system_time()
  def now({:simulated, time}), do: :atomics.get(time, 1)

  def now(cells),
    do: max(:os.perf_counter() + :atomics.get(cells, 1), :atomics.get(cells, 2))

  @doc """
  Returns the two words adjusted to a counter value and a system time that were read together.

      iex> Situ.Clock.Wall.adjust_offset({0, 0}, 5_000, 6_000)
      {0, 0}
      iex> Situ.Clock.Wall.adjust_offset({0, 0}, 5_000, 3_600_000_005_000)
      {3_600_000_000_000, 0}
      iex> Situ.Clock.Wall.adjust_offset({0, 0}, 3_600_000_005_000, 5_000)
      {-3_600_000_000_000, 3_600_001_005_000}
  """
  @spec adjust_offset(line(), integer(), Situ.Time.t()) :: line()
  def adjust_offset({offset, floor} = line, counter, system) do
    ahead = system - counter - offset

    cond do
      abs(ahead) <= @drift -> line
      ahead > 0 -> {offset + ahead, floor}
      true -> {offset + ahead, max(counter + offset, floor) + @margin}
    end
  end

  @doc """
  Starts the process that updates the cells of this node (or `cells:`) from the system time every `every:` ms. `read:`
  returns the counter and the system time, read together.
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @impl true
  def init(opts) do
    read = opts[:read] || (&read_times/0)

    if :erlang.convert_time_unit(1, :second, :perf_counter) == 1_000_000_000 do
      cells = opts[:cells] || ensure_cells(read)
      {:ok, schedule_check({cells, read, opts[:every] || @every_ms})}
    else
      :ignore
    end
  end

  # After a restart this process continues with the cells that existing clocks hold.
  defp ensure_cells(read) do
    with nil <- shared_cells() do
      cells = new_cells(read.())
      :persistent_term.put(__MODULE__, cells)
      cells
    end
  end

  @doc "Creates cells that match the system time now."
  @spec new_cells({integer(), Situ.Time.t()}) :: cells()
  def new_cells({counter, system}) do
    cells = :atomics.new(2, signed: true)
    :atomics.put(cells, 1, system - counter)
    cells
  end

  @impl true
  def handle_info(:look, {cells, read, _every} = state) do
    {counter, system} = read.()
    line = {:atomics.get(cells, 1), :atomics.get(cells, 2)}

    with {offset, floor} when {offset, floor} != line <- adjust_offset(line, counter, system) do
      # The floor is written first, because no reader may see the new offset without it.
      :atomics.put(cells, 2, floor)
      :atomics.put(cells, 1, offset)
    end

    {:noreply, schedule_check(state)}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp schedule_check({_cells, _read, every} = state) do
    Process.send_after(self(), :look, every)
    state
  end

  # Takes the fastest of a few readings, because the process may have been suspended during any of them.
  defp read_times do
    {_, counter, system} =
      for _ <- 1..@tries do
        before = :os.perf_counter()
        system = :os.system_time()
        took = :os.perf_counter() - before
        {took, before + div(took, 2), system}
      end
      |> Enum.min()

    {counter, system}
  end
end
