defmodule Situ.Studio.Sensor do
  @schema [
    page: [
      type: :string,
      default: "page",
      doc: "The page's name: its address is `/sensor?name=NAME` of the studio."
    ],
    buffer: [
      type: :pos_integer,
      default: 200,
      doc: "Pieces of sound that may wait for a slow pipeline; then the oldest is dropped."
    ]
  ]

  @moduledoc """
  A browser's camera and microphone as a source: a page of the studio, on this machine or on a phone.

      sensor = Situ.Studio.Sensor.open(p, page: "phone")
      sensor.video |> Situ.map(&Situ.Imaging.parse!(&1.data), type: Situ.Image)
      sensor.audio |> Situ.Audio.resample(16_000)
      Situ.Studio.Sensor.Speaker.play(answer, page: "phone")

  The user opens `/sensor?name=phone` in the studio, chooses camera and microphone and starts them. Browsers allow
  that on this machine, and elsewhere only over TLS (`Situ.Studio`, `tls: :own`).

  | output | gives |
  |---|---|
  | `:video` | pictures as JPEG, `Situ.EncodedImage` |
  | `:audio` | sound at the browser's rate (mostly 48 kHz), 16 bit, mono; each piece at its end |
  | `:clock` | how far the browser's clock is ahead, ms, each time it is measured |

  Times are the browser's, corrected by the difference of the clocks, which is measured by short round trips and is off
  by half of the shortest at most. A picture is taken when the pipeline has taken the one before: a slow pipeline drops
  pictures in the browser, before they are made.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Situ.Component,
    outputs: [video: Situ.EncodedImage, audio: Situ.AudioBuffer, clock: :float],
    options: @schema

  alias Situ.Error

  # Pictures that may be under way.
  @ahead 2

  defstruct [:opts, :page, waiting: %{}, dropped: 0, last: %{}]

  @doc "Adds the sensor to a pipeline; returns its streams."
  @spec open(Situ.Pipeline.t(), keyword()) :: %{
          video: Situ.Stream.t(),
          audio: Situ.Stream.t(),
          clock: Situ.Stream.t()
        }
  def open(p, opts \\ []), do: Situ.source(p, __MODULE__, opts)

  @impl true
  def init(opts), do: {:ok, %__MODULE__{opts: Map.new(opts)}}

  @impl true
  def handle_start(_context, %{opts: %{page: name}} = state) do
    case Registry.register(Situ.Studio.Registry, {:sensor, name}, nil) do
      {:ok, _} ->
        {[{:complete, :infinity}], state}

      {:error, _} ->
        raise Error.new(:sensor_taken, "a sensor called #{inspect(name)} runs already",
                fix: "give this one another page:"
              )
    end
  end

  @doc "The process of the sensor with this name. For the page's connection."
  @spec find(String.t()) :: {:ok, pid()} | :error
  def find(name) do
    case Registry.lookup(Situ.Studio.Registry, {:sensor, name}) do
      [{pid, _}] -> {:ok, pid}
      [] -> :error
    end
  end

  @impl true
  def handle_info({:sensor_page, pid}, _context, state) do
    Process.monitor(pid)
    send(pid, {:credit, @ahead})
    {[], %{state | page: pid}}
  end

  def handle_info({:DOWN, _, :process, pid, _}, _context, %{page: pid} = state),
    do: {[], %{state | page: nil}}

  def handle_info({:sensor, output, time, data}, _context, state),
    do: {[], push(state, output, time, data)}

  def handle_info(_other, _context, state), do: {[], state}

  # Two clocks that are measured against each other may step back a little.
  defp push(state, output, time, data) do
    case state.last do
      %{^output => last} when time <= last ->
        credit(output, %{state | dropped: state.dropped + 1})

      last ->
        queue = :queue.in({time, data}, Map.get(state.waiting, output, :queue.new()))
        limit(put_in(%{state | last: Map.put(last, output, time)}.waiting[output], queue), output)
    end
  end

  # Pictures are as few as the page was given leave for.
  defp limit(state, :video), do: state

  defp limit(state, output) do
    if :queue.len(state.waiting[output]) > state.opts.buffer do
      state = update_in(state.waiting[output], &:queue.drop/1)
      %{state | dropped: state.dropped + 1}
    else
      state
    end
  end

  @impl true
  def handle_demand(n, _context, state), do: take(state, n, [])

  defp take(state, 0, actions), do: {Enum.reverse(actions), state}

  # The earliest first.
  defp take(state, n, actions) do
    heads =
      for {output, queue} <- state.waiting,
          {:value, {time, _}} <- [:queue.peek(queue)],
          do: {time, output}

    case Enum.min(heads, fn -> nil end) do
      nil ->
        {Enum.reverse(actions), state}

      {time, output} ->
        {{:value, {^time, data}}, queue} = :queue.out(state.waiting[output])
        state = credit(output, put_in(state.waiting[output], queue))
        take(state, n - 1, [{output, time, data} | actions])
    end
  end

  # The page may take another picture.
  defp credit(:video, %{page: pid} = state) when is_pid(pid) do
    send(pid, {:credit, 1})
    state
  end

  defp credit(_output, state), do: state

  @impl true
  def handle_stop(_final_time, _context, state), do: {[], state}

  @impl true
  def terminate(_reason, %{page: nil}), do: :ok
  def terminate(_reason, %{page: pid}), do: send(pid, :sensor_ended)

  @impl true
  def describe(state),
    do: "#{if state.page, do: "a page is there", else: "no page"}, #{state.dropped} dropped"
end
