defmodule Situ.Bridge.Inlet do
  @moduledoc false
  # What every source of a network does with what arrives: read it by the format, give it a time, keep the times of
  # the stream increasing. Nothing that comes from outside stops a pipeline: what cannot be used is left out and
  # counted. Pure.
  alias Situ.Bridge.Format

  @options [
    format: [
      type: {:in, [:json, :csv, :message_pack, :situ, :raw]},
      default: :json,
      doc: "How messages are written (`Situ.Bridge.Format`); `:raw`: the bytes as they are."
    ],
    times: [
      type: {:in, [:sender, :arrival]},
      default: :sender,
      doc: "Originating times: the sender's, or when a message arrives (always with `:raw`)."
    ],
    objects: [
      type: {:in, [:maps, :pairs]},
      default: :maps,
      doc: "How objects come, see `Situ.Bridge.Format`."
    ],
    type: [type: :any, default: :any, doc: "Type of the stream."]
  ]

  defstruct [:format, :times, :opts, :last, :trouble, taken: 0, unreadable: 0, late: 0]
  @type t :: %__MODULE__{}

  @doc "The options that all such sources have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts),
    do: %__MODULE__{format: opts[:format], times: opts[:times], opts: [objects: opts[:objects]]}

  @doc "The messages as `{:out, time, value}`, and why the last one left out was."
  @spec take(t(), [binary()], now :: Situ.Time.t()) :: {[tuple()], t()}
  def take(inlet, payloads, now) do
    {found, inlet} = Enum.reduce(payloads, {[], inlet}, &one(&1, &2, now))
    {Enum.reverse(found), inlet}
  end

  defp one(payload, {found, inlet}, now) do
    case read(inlet, payload, now) do
      {:ok, {time, value}} -> timed(time, value, found, inlet)
      {:error, error} -> {found, %{inlet | unreadable: inlet.unreadable + 1, trouble: error}}
    end
  end

  defp read(%{format: :raw}, payload, now), do: {:ok, {now, payload}}

  defp read(inlet, payload, now) do
    with {:ok, {time, value}} <- Format.decode(inlet.format, payload, inlet.opts),
         do: {:ok, {if(inlet.times == :arrival, do: now, else: time), value}}
  end

  # Two may arrive within one reading of the clock; a sender's own times are its own fault.
  defp timed(time, value, found, inlet) do
    cond do
      inlet.last == nil or time > inlet.last -> post(time, value, found, inlet)
      inlet.format == :raw or inlet.times == :arrival -> post(inlet.last + 1, value, found, inlet)
      true -> {found, %{inlet | late: inlet.late + 1}}
    end
  end

  defp post(time, value, found, inlet),
    do: {[{:out, time, value} | found], %{inlet | last: time, taken: inlet.taken + 1}}

  @doc "One line for people."
  @spec describe(t()) :: String.t()
  def describe(inlet),
    do:
      "#{inlet.taken} messages, #{inlet.unreadable} unreadable, #{inlet.late} not later than the one before"
end
