defmodule Situ.Bridge.Outlet do
  @moduledoc false
  # The common part of all network sinks: it encodes messages by the format, waits for peers if asked to, makes the
  # stream wait while no peer has room, and lingers at the end. `use Situ.Bridge.Outlet` in a component whose state is
  # an outlet gives it all callbacks but the first ones. The counterpart of `Situ.Bridge.Inlet`.
  alias Situ.Bridge.Format
  alias Situ.Error

  @typedoc "Who has the peers, as the door knows it."
  @type server :: term()

  @doc "How many peers want to have messages."
  @callback ready(server()) :: non_neg_integer()
  @doc "How many messages were dropped for peers that are too slow."
  @callback dropped(server()) :: non_neg_integer()
  @doc "Sends to whom it concerns; `:full` when the stream is to wait."
  @callback put(server(), what :: term()) :: :ok | :full
  @doc """
  Closes after at most so many ms of waiting for messages under way. Answers how many that had been taken are lost;
  those that it may lose at any time do not count.
  """
  @callback close(server(), timeout :: non_neg_integer()) :: lost :: non_neg_integer()

  @options [
    format: [
      type: {:in, [:json, :csv, :message_pack, :situ, :raw]},
      default: :json,
      doc: "A format of `Situ.Bridge.Format`; `:raw`: data that are bytes, as they are."
    ],
    high_water_mark: [
      type: :pos_integer,
      default: 1_000,
      doc: "The most messages that wait for one peer."
    ],
    wait_for: [
      type: :non_neg_integer,
      default: 0,
      doc: "Send nothing before so many peers (subscribers) are there."
    ],
    linger: [
      type: :non_neg_integer,
      default: 1_000,
      doc:
        "How long to wait at the end for somebody who takes what is still to be sent, ms. If nobody does, the error " <>
          "`:not_delivered` tells how many messages are lost."
    ],
    listening: [
      type: {:optional, :pid},
      default: nil,
      doc: "Gets `{:listening, port}` once bound; of use with port 0."
    ]
  ]

  # `until`: when it gives up, if nothing goes through the door before; known from the end of the pipeline on.
  defstruct [:opts, :door, :server, :until, waiting: false, holding: false, held: [], lost: 0]
  @type t :: %__MODULE__{}

  defmacro __using__(_opts) do
    quote do
      @impl true
      def handle_info(message, _context, outlet), do: Situ.Bridge.Outlet.told(outlet, message)
      @impl true
      def handle_closed(:in, _time, _context, outlet), do: {[], Situ.Bridge.Outlet.close(outlet)}
      @impl true
      def terminate(_reason, outlet), do: Situ.Bridge.Outlet.abandon(outlet)
      @impl true
      def describe(outlet), do: Situ.Bridge.Outlet.describe(outlet)
    end
  end

  @doc "The options that all such sinks have."
  def options, do: @options

  @spec new(keyword()) :: t()
  def new(opts), do: %__MODULE__{opts: opts, waiting: opts[:wait_for] > 0}

  @doc "Goes through a door that is open, a module of this behaviour and its process; `port` is the one it got, if any."
  @spec open(t(), module(), server(), :inet.port_number() | nil) :: t()
  def open(outlet, door, server, port) do
    if outlet.opts[:listening] && port, do: send(outlet.opts[:listening], {:listening, port})
    %{outlet | door: door, server: server}
  end

  @doc "One message by the format of the options. Raises `Situ.Error` (`:not_writable`)."
  @spec payload(Situ.Message.t(), keyword()) :: iodata()
  def payload(%{data: data} = message, opts) do
    case opts[:format] do
      :raw when is_binary(data) -> data
      :raw -> raise Format.not_writable(:raw, data)
      format -> Error.unwrap!(Format.encode(format, data, message.originating_time))
    end
  end

  @doc "Sends what goes through the door, or keeps it and holds the input `in` until there is room."
  @spec take(t(), what :: term()) :: {[tuple()], t()}
  def take(outlet, payload), do: pour(%{outlet | held: outlet.held ++ [payload]})

  @doc "The stage tells the component: a hold has ended, or the pipeline comes to its end."
  @spec told(t(), term()) :: {[tuple()], t()}
  def told(outlet, {:hold_ended, :in}), do: pour(outlet)
  def told(%{until: nil} = outlet, {:linger, :end}), do: outlet |> moved() |> pour()
  def told(outlet, _other), do: {[], outlet}

  defp moved(outlet), do: %{outlet | until: now() + outlet.opts[:linger]}

  defp pour(%{waiting: true} = outlet) do
    if outlet.door.ready(outlet.server) >= outlet.opts[:wait_for],
      do: pour(%{outlet | waiting: false}),
      else: wait(outlet)
  end

  defp pour(%{held: [], holding: true} = outlet),
    do: {[{:resume, :in}, {:linger, false}], %{outlet | holding: false}}

  defp pour(%{held: []} = outlet), do: {[], outlet}

  defp pour(%{held: [payload | rest]} = outlet) do
    case outlet.door.put(outlet.server, payload) do
      :ok -> pour(%{if(outlet.until, do: moved(outlet), else: outlet) | held: rest})
      :full -> wait(outlet)
    end
  end

  # A pipeline that ends does not wait for ever.
  defp wait(%{until: until} = outlet) do
    if until != nil and now() >= until,
      do: pour(%{outlet | waiting: false, held: [], lost: outlet.lost + length(outlet.held)}),
      else: {[{:hold, :in}, {:linger, true}], %{outlet | holding: true}}
  end

  @doc "The end of the stream. Raises `Situ.Error` (`:not_delivered`) when something of it is lost."
  @spec close(t()) :: t()
  def close(outlet) do
    outlet = outlet |> moved() |> drain()
    lost = outlet.lost + outlet.door.close(outlet.server, outlet.opts[:linger])
    if lost > 0, do: raise(not_delivered(lost, outlet.opts[:linger]))
    %{outlet | server: nil}
  end

  # There is nothing else to do any more than to wait for what is held.
  defp drain(outlet) do
    {_, outlet} = pour(outlet)

    if outlet.held == [] do
      outlet
    else
      receive do
      after
        5 -> drain(outlet)
      end
    end
  end

  defp not_delivered(lost, linger) do
    what = if lost == 1, do: "a message was", else: "#{lost} messages were"

    Error.new(:not_delivered, what <> " not delivered",
      why: "nobody took them within #{linger} ms after the end",
      fix: "look after the other side, or let the end wait longer (`linger:`)"
    )
  end

  defp now, do: System.monotonic_time(:millisecond)

  @doc "Closes without waiting."
  @spec abandon(t()) :: :ok
  def abandon(%{server: nil}), do: :ok

  def abandon(outlet) do
    _lost = outlet.door.close(outlet.server, 0)
    :ok
  end

  @doc "One line for people."
  @spec describe(t()) :: String.t()
  def describe(%{server: nil}), do: "closed"

  def describe(%{door: door, server: server}),
    do: "#{door.ready(server)} peers, #{door.dropped(server)} messages dropped"
end
