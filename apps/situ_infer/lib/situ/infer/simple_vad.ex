defmodule Situ.Infer.SimpleVad do
  @moduledoc """
  Detects voice activity from log energy alone, by unanimity. Speech starts where all values of the next 300 ms are
  above the threshold, and ends where all of them are below it; otherwise the state is unchanged.

  Input `:in` is a number, the log energy of an audio frame (`ln` of the mean square of 16-bit samples, as computed by
  the acoustic features). Output `:out` is a boolean at the same time. A value is decided when the stream reaches the
  end of its window, so the output is delayed by 300 ms; the last 300 ms of a stream are decided by the existing values.
  It is sufficient for a quiet room and a close microphone; `Situ.Infer.VoiceActivity` is better everywhere else.

      iex> vad = Situ.Infer.SimpleVad.new(window: 20)
      iex> {[], vad} = Situ.Infer.SimpleVad.push(vad, 0, 9.0)
      iex> {[], vad} = Situ.Infer.SimpleVad.push(vad, 10, 9.0)
      iex> {out, _} = Situ.Infer.SimpleVad.push(vad, 20, 8.0)
      iex> out
      [{0, true}]
  """

  @schema [
    threshold: [
      type: :number,
      default: 7.0,
      doc: "The log energy that separates noise from speech."
    ],
    window: [
      type: :time_ns,
      default: 300_000_000,
      doc: "How far ahead all values must agree, in ns."
    ]
  ]

  use Situ.Component, inputs: [in: :number], outputs: [out: :boolean], options: @schema

  defstruct [:threshold, :window, speaking?: false, ahead: :queue.new()]

  @type t :: %__MODULE__{}
  @type decisions :: [{Situ.Time.t(), boolean()}]

  @doc "Returns the initial state, without speech. See the options above."
  @spec new(keyword()) :: t()
  def new(opts \\ []), do: opts |> Situ.Options.validate!(@schema) |> build_gate()

  @impl true
  def init(opts), do: {:ok, build_gate(opts)}

  @impl true
  def handle_message(:in, message, _context, vad) do
    {decisions, vad} = push(vad, message.originating_time, message.data)
    {for({time, speaking?} <- decisions, do: {:out, time, speaking?}), vad}
  end

  @impl true
  def handle_closed(:in, _time, _context, vad) do
    {decisions, vad} = close(vad)
    {for({time, speaking?} <- decisions, do: {:out, time, speaking?}), vad}
  end

  @doc "Adds the next log energy, and returns the values that it decides."
  @spec push(t(), Situ.Time.t(), number()) :: {decisions(), t()}
  def push(%__MODULE__{} = vad, time, value) do
    decide_values(%{vad | ahead: :queue.in({time, value - vad.threshold}, vad.ahead)}, time, [])
  end

  @doc "Ends the input, and returns the remaining values."
  @spec close(t()) :: {decisions(), t()}
  def close(%__MODULE__{} = vad), do: decide_values(vad, :infinity, [])

  defp build_gate(opts), do: %__MODULE__{threshold: opts[:threshold], window: opts[:window]}

  defp decide_values(vad, now, done) do
    case :queue.peek(vad.ahead) do
      # `now` is an integer or :infinity, which sorts after every number.
      {:value, {time, _}} when now >= time + vad.window ->
        vad = decide_unanimously(vad, time + vad.window)
        decide_values(%{vad | ahead: :queue.drop(vad.ahead)}, now, [{time, vad.speaking?} | done])

      _ ->
        {Enum.reverse(done), vad}
    end
  end

  defp decide_unanimously(vad, until) do
    above = for {time, above} <- :queue.to_list(vad.ahead), time <= until, do: above

    # A value at the threshold is neither speech nor silence.
    cond do
      Enum.all?(above, &(&1 > 0)) -> %{vad | speaking?: true}
      Enum.all?(above, &(&1 < 0)) -> %{vad | speaking?: false}
      true -> vad
    end
  end
end
