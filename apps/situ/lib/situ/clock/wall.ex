defmodule Situ.Clock.Wall do
  @moduledoc false
  # Wall time that never goes back: the processor's counter plus an offset that is held against the system's time once
  # a second. Where they differ by more than 0.1 ms (somebody set the system's time, the machine slept), wall time
  # jumps if the system is ahead, and stands still until the system has caught up if it is behind.
  #
  # The VM's own system time would do the same by running a percent faster or slower: an hour would take it four days.
  use GenServer

  @every_ms 1_000
  @drift 100_000
  # How far a reading by the old offset may be ahead, ns: other schedulers see the new offset a little later.
  @margin 1_000_000
  @tries 8

  @typedoc "Two words: the offset of the counter, and the lowest time that a reading may return."
  @type cells :: :atomics.atomics_ref()
  @type line :: {offset :: integer(), floor :: integer()}

  @doc "The cells of this node; `nil` if no process keeps them: then the system's time is read."
  @spec cells() :: cells() | nil
  def cells, do: :persistent_term.get(__MODULE__, nil)

  @doc "The wall time, ns since 1970."
  @spec now(cells() | nil) :: Situ.Time.t()
  def now(cells \\ cells())
  def now(nil), do: :os.system_time()

  def now(cells),
    do: max(:os.perf_counter() + :atomics.get(cells, 1), :atomics.get(cells, 2))

  @doc """
  The line after the counter and the system's time were read together.

      iex> Situ.Clock.Wall.adjust({0, 0}, 5_000, 6_000)
      {0, 0}
      iex> Situ.Clock.Wall.adjust({0, 0}, 5_000, 3_600_000_005_000)
      {3_600_000_000_000, 0}
      iex> Situ.Clock.Wall.adjust({0, 0}, 3_600_000_005_000, 5_000)
      {-3_600_000_000_000, 3_600_001_005_000}
  """
  @spec adjust(line(), integer(), Situ.Time.t()) :: line()
  def adjust({offset, floor} = line, counter, system) do
    ahead = system - counter - offset

    cond do
      abs(ahead) <= @drift -> line
      ahead > 0 -> {offset + ahead, floor}
      true -> {offset + ahead, max(counter + offset, floor) + @margin}
    end
  end

  @doc """
  Keeps the cells of this node (or those of `cells:`) and compares the times `every:` so many ms. `read:` returns the
  counter and the system's time, read together.
  """
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @impl true
  def init(opts) do
    read = opts[:read] || (&read/0)

    if :erlang.convert_time_unit(1, :second, :perf_counter) == 1_000_000_000 do
      cells = opts[:cells] || keep(read)
      {:ok, later({cells, read, opts[:every] || @every_ms})}
    else
      :ignore
    end
  end

  # A keeper that was restarted goes on with the cells that clocks hold.
  defp keep(read) do
    with nil <- cells() do
      cells = new(read.())
      :persistent_term.put(__MODULE__, cells)
      cells
    end
  end

  @doc "Cells that agree with the system's time now."
  @spec new({integer(), Situ.Time.t()}) :: cells()
  def new({counter, system}) do
    cells = :atomics.new(2, signed: true)
    :atomics.put(cells, 1, system - counter)
    cells
  end

  @impl true
  def handle_info(:look, {cells, read, _every} = state) do
    {counter, system} = read.()
    line = {:atomics.get(cells, 1), :atomics.get(cells, 2)}

    with {offset, floor} when {offset, floor} != line <- adjust(line, counter, system) do
      # Nobody may read the new offset without the floor.
      :atomics.put(cells, 2, floor)
      :atomics.put(cells, 1, offset)
    end

    {:noreply, later(state)}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp later({_cells, _read, every} = state) do
    Process.send_after(self(), :look, every)
    state
  end

  # Of a few readings that which took least: the process may have been suspended in the middle of one.
  defp read do
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
