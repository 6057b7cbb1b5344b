defmodule Situ.MapAsync do
  @moduledoc false
  # A map whose function runs for several messages concurrently, each in its own process. Results are emitted in the
  # order of the messages. `Situ.map_async/3` documents it.

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
  alias Situ.Graph.Placement
  alias Situ.{Argument, Operator, Stream}

  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  def map_async(%Stream{} = stream, fun, opts)
      when is_function(fun, 1) or is_function(fun, 2) do
    {own, placement} = Placement.split_options!(opts, @schema, :operator)
    own = Keyword.put_new(own, :max, System.schedulers_online())
    options = [fun: fun] ++ own
    Operator.attach_component(stream, "MapAsync", {Situ.MapAsync.Component, options}, placement)
  end

  def map_async(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.map_async(stream, fn data -> data end)")
end
