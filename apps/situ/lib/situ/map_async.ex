defmodule Situ.MapAsync do
  @schema [
    max: [
      type: :pos_integer,
      doc:
        "Maximum number of messages in progress or waiting for an older one (default: one per core)."
    ],
    timeout: [
      type: {:or, [:pos_integer, {:in, [:infinity]}]},
      default: :infinity,
      doc: "Maximum time per message, in ms of real time; exceeding it is an error."
    ]
  ]

  @moduledoc """
  A map whose function runs for several messages concurrently, each in its own process. Results are emitted in the order
  of the messages.

  Use it for functions that wait (for a server or a file) or that use more than one core. Cheap functions are faster in
  `Situ.map/3`, because a process per message costs a few microseconds.

      iex> square = fn v -> v * v end
      iex> build = fn p -> p |> Situ.from_enumerable(1..5, every: 10) |> Situ.map_async(square, max: 2) end
      iex> Situ.to_list(build, pipeline: [replay: [interval: {0, :unbounded}, speed: :max]])
      [1, 4, 9, 16, 25]
  """
  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}

  @doc """
  Applies `fun` (of data, or of data and message) to up to `max:` messages concurrently, and emits the results in order.

  When `max:` messages are in progress, the stream waits. If the function raises, exits or exceeds `timeout:`, that is
  an error at its message's time, which is handled as `on_error:` specifies: `:stop` emits the results of older
  messages, `:skip` emits all other results, and `:restart` also discards the messages in progress. Reproducible: yes,
  if `fun` is.

  #{Situ.Options.docs(@schema)}
  """
  @spec map_async(
          Stream.t(),
          (term() -> term()) | (term(), Situ.Message.t() -> term()),
          keyword()
        ) ::
          Stream.t()
  def map_async(stream, fun, opts \\ [])

  def map_async(%Stream{} = stream, fun, opts)
      when is_function(fun, 1) or is_function(fun, 2) do
    {own, placed} = Placement.split_options!(opts, @schema, :operator)
    own = Keyword.put_new(own, :max, System.schedulers_online())
    own = [fun: fun, on_error: placed[:on_error] || :stop] ++ own
    given = for {key, value} <- own, do: {if(key == :on_error, do: :errors, else: key), value}
    Operator.attach_component(stream, "MapAsync", {Situ.MapAsync.Component, given}, placed)
  end

  def map_async(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.map_async(stream, fn data -> data end)")
end
