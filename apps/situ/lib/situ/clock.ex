defmodule Situ.Clock do
  @moduledoc """
  The clocks of pipelines: real, virtual (starts at a given time, runs at a given speed, can be paused) and manual
  (advanced by a test).

  A clock is in shared memory. Reading it takes about 50 ns from any process, and all readers see a pause, a new speed
  or a jump immediately. A clock notifies its pipelines of every change, so that components waiting for a time wake
  up.

      iex> clock = Situ.Clock.manual(100)
      iex> :ok = Situ.Clock.advance(clock, 20)
      iex> Situ.Clock.now(clock)
      120

      iex> clock = Situ.Clock.virtual(0, 2.0)
      iex> :ok = Situ.Clock.pause(clock)
      iex> Situ.Clock.now(clock) == Situ.Clock.now(clock)
      true
  """
  # Cells: 1 version (odd while a process is writing), 2 origin, 3 wall time of the origin, 4 speed in millionths
  # (0 while paused), 5 the speed to resume with.
  @enforce_keys [:kind]
  defstruct [:kind, :cells, :wall]

  @type kind :: :real | :virtual | :manual
  @type t :: %__MODULE__{
          kind: kind(),
          cells: :atomics.atomics_ref() | {:simulated, :atomics.atomics_ref()} | nil,
          wall: term()
        }

  alias Situ.Clock.Wall

  @registry __MODULE__.Listeners

  @doc """
  Returns the wall clock. It never goes backward. If the system time is set back, the clock pauses until the system
  time catches up; if the system time is set forward, the clock follows within a second.
  """
  @spec real() :: t()
  def real, do: %__MODULE__{kind: :real, cells: Wall.current_cells()}

  @doc "Returns a pausable clock that starts now at `origin` (ns) and runs `speed` times as fast as the wall clock."
  @spec virtual(Situ.Time.t(), number()) :: t()
  def virtual(origin, speed \\ 1.0) when is_integer(origin) and is_number(speed) and speed > 0 do
    cells = :atomics.new(5, signed: true)
    wall = Wall.current_cells()
    speed = speed_in_millionths(speed)
    init_cells(cells, origin, Wall.now(wall), speed, speed)
    %__MODULE__{kind: :virtual, cells: cells, wall: wall}
  end

  @doc "Returns a clock that stays at `time` until `advance/2` or `set/2` moves it."
  @spec manual(Situ.Time.t()) :: t()
  def manual(time \\ 0) when is_integer(time) do
    cells = :atomics.new(5, signed: true)
    init_cells(cells, time, 0, 0, 0)
    %__MODULE__{kind: :manual, cells: cells}
  end

  @doc "Returns the current time, ns."
  @spec now(t()) :: Situ.Time.t()
  def now(%__MODULE__{kind: :real, cells: cells}), do: Wall.now(cells)
  def now(%__MODULE__{kind: :manual, cells: cells}), do: :atomics.get(cells, 2)

  def now(%__MODULE__{kind: :virtual, cells: cells, wall: wall}) do
    {origin, since, speed, _} = read_cells(cells)
    clock_time(origin, since, speed, Wall.now(wall))
  end

  @doc "Returns the wall milliseconds (rounded up) until the clock reaches `time`, or `:never` while it is not moving."
  @spec wait_ms(t(), Situ.Time.t()) :: non_neg_integer() | :never
  def wait_ms(%__MODULE__{kind: :real, cells: cells}, time), do: ceil_ms(time - Wall.now(cells))

  def wait_ms(%__MODULE__{kind: :manual} = clock, time),
    do: if(now(clock) >= time, do: 0, else: :never)

  def wait_ms(%__MODULE__{kind: :virtual, cells: cells, wall: wall}, time) do
    {origin, since, speed, _} = read_cells(cells)
    ahead = time - clock_time(origin, since, speed, Wall.now(wall))

    cond do
      ahead <= 0 -> 0
      speed == 0 -> :never
      true -> ceil_ms(div(ahead * 1_000_000, speed) + 1)
    end
  end

  @doc "Moves a manual clock forward by `duration` ns."
  @spec advance(t(), Situ.Time.duration()) :: :ok
  def advance(%__MODULE__{kind: :manual, cells: cells} = clock, duration) when duration >= 0 do
    :atomics.add(cells, 2, duration)
    notify_listeners(clock)
  end

  @doc "Moves a manual clock to `time`, which must not be before its current time."
  @spec set(t(), Situ.Time.t()) :: :ok
  def set(%__MODULE__{kind: :manual} = clock, time) do
    if time < now(clock), do: raise(ArgumentError, "a clock cannot be set back")
    :atomics.put(clock.cells, 2, time)
    notify_listeners(clock)
  end

  @doc "Pauses a virtual clock."
  @spec pause(t()) :: :ok | {:error, Situ.Error.t()}
  def pause(clock) do
    update_cells(clock, fn origin, wall, speed, resume ->
      now = Wall.now(clock.wall)
      {clock_time(origin, wall, speed, now), now, 0, resume}
    end)
  end

  @doc "Resumes a paused clock from the time at which it was paused."
  @spec resume(t()) :: :ok | {:error, Situ.Error.t()}
  def resume(clock) do
    update_cells(clock, fn origin, wall, speed, resume ->
      now = Wall.now(clock.wall)
      {clock_time(origin, wall, speed, now), now, resume, resume}
    end)
  end

  @doc "Changes the speed of a virtual clock without a jump. A paused clock stays paused and resumes at the new speed."
  @spec set_speed(t(), number()) :: :ok | {:error, Situ.Error.t()}
  def set_speed(clock, speed) when is_number(speed) and speed > 0 do
    update_cells(clock, fn origin, wall, old, _resume ->
      now = Wall.now(clock.wall)
      next = if old == 0, do: 0, else: speed_in_millionths(speed)
      {clock_time(origin, wall, old, now), now, next, speed_in_millionths(speed)}
    end)
  end

  @doc "Moves a virtual or manual clock forward to `time`, even while paused; a clock already past `time` is unchanged."
  @spec jump(t(), Situ.Time.t()) :: :ok | {:error, Situ.Error.t()}
  def jump(%__MODULE__{kind: :manual} = clock, time), do: set(clock, max(time, now(clock)))

  def jump(clock, time) do
    update_cells(clock, fn origin, wall, speed, resume ->
      now = Wall.now(clock.wall)
      {max(time, clock_time(origin, wall, speed, now)), now, speed, resume}
    end)
  end

  @doc "Returns the speed relative to the wall clock, 0.0 while paused, or `:manual` for manual clocks."
  @spec speed(t()) :: float() | :manual
  def speed(%__MODULE__{kind: :real}), do: 1.0
  def speed(%__MODULE__{kind: :manual}), do: :manual
  def speed(%__MODULE__{cells: cells}), do: elem(read_cells(cells), 2) / 1_000_000

  @doc """
  Subscribes the calling process to `{:situ_clock, clock}`, sent when the clock is paused, resumed, moved or changes
  speed.
  """
  @spec subscribe(t()) :: :ok
  def subscribe(%__MODULE__{kind: :real}), do: :ok

  def subscribe(%__MODULE__{cells: cells}) do
    {:ok, _} = Registry.register(@registry, cells, nil)
    :ok
  end

  @doc false
  def registry_spec, do: {Registry, keys: :duplicate, name: @registry}

  defp notify_listeners(%__MODULE__{cells: cells} = clock) do
    Registry.dispatch(@registry, cells, fn listeners ->
      Enum.each(listeners, fn {pid, _} -> send(pid, {:situ_clock, clock}) end)
    end)
  end

  defp update_cells(%__MODULE__{kind: :virtual, cells: cells} = clock, fun) do
    lock_cells(cells)
    origin = :atomics.get(cells, 2)
    wall = :atomics.get(cells, 3)

    {origin, wall, speed, resume} =
      fun.(origin, wall, :atomics.get(cells, 4), :atomics.get(cells, 5))

    put_cells(cells, origin, wall, speed, resume)
    :atomics.add(cells, 1, 1)
    notify_listeners(clock)
  end

  defp update_cells(%__MODULE__{kind: kind}, _fun) do
    {:error,
     Situ.Error.new(:fixed_clock, "a #{kind} clock cannot be paused or run at a different speed",
       why: "only replayed (virtual) time supports this",
       fix: "start the pipeline with a replay interval, or with clock: Situ.Clock.virtual(start)"
     )}
  end

  # A writer makes the version odd, which excludes all other writers.
  defp lock_cells(cells) do
    version = :atomics.get(cells, 1)

    if rem(version, 2) == 1 or :atomics.compare_exchange(cells, 1, version, version + 1) != :ok do
      :erlang.yield()
      lock_cells(cells)
    end
  end

  # Each process caches the values it has read; the version shows whether they are still valid.
  defp read_cells(cells) do
    version = :atomics.get(cells, 1)

    case Process.get(__MODULE__) do
      {^cells, ^version, value} -> value
      _ -> read_cells(cells, version)
    end
  end

  defp read_cells(cells, version) do
    value =
      {:atomics.get(cells, 2), :atomics.get(cells, 3), :atomics.get(cells, 4),
       :atomics.get(cells, 5)}

    if rem(version, 2) == 0 and :atomics.get(cells, 1) == version do
      Process.put(__MODULE__, {cells, version, value})
      value
    else
      read_cells(cells)
    end
  end

  defp init_cells(cells, origin, wall, speed, resume) do
    put_cells(cells, origin, wall, speed, resume)
    :ok
  end

  defp put_cells(cells, origin, wall, speed, resume) do
    :atomics.put(cells, 2, origin)
    :atomics.put(cells, 3, wall)
    :atomics.put(cells, 4, speed)
    :atomics.put(cells, 5, resume)
  end

  defp clock_time(origin, wall, 1_000_000, now), do: origin + max(now - wall, 0)

  defp clock_time(origin, wall, speed, now),
    do: origin + div(max(now - wall, 0) * speed, 1_000_000)

  defp speed_in_millionths(speed), do: max(round(speed * 1_000_000), 1)

  defp ceil_ms(ns) when ns <= 0, do: 0
  defp ceil_ms(ns), do: min(div(ns + 999_999, 1_000_000), 4_000_000_000)

  defimpl Inspect do
    def inspect(%{kind: :manual} = clock, _opts),
      do: "#Situ.Clock<manual at #{Situ.Clock.now(clock)} ns>"

    def inspect(%{kind: :virtual} = clock, _opts) do
      time = Situ.Time.to_iso8601(Situ.Clock.now(clock))
      "#Situ.Clock<virtual at #{time}, speed #{Situ.Clock.speed(clock)}>"
    end

    def inspect(%{kind: kind}, _opts), do: "#Situ.Clock<#{kind}>"
  end
end
