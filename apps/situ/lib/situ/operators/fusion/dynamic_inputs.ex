defmodule Situ.Fusion.DynamicInputs do
  @moduledoc false
  # Asks a running pipeline to add an input to a fusion operator, or to remove one.
  alias Situ.{Argument, Error, Options, Pipeline, Stream}

  @policy [policy: [type: {:struct, Situ.Delivery}]]

  @doc "Adds an input, see `Situ.Fusion.add_input/4`."
  @spec add(term(), term(), Stream.t() | String.t(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def add(fused, key, stream, opts) do
    {policy, request} = Keyword.split(opts, [:policy])
    policy = Options.validate!(policy, @policy)[:policy]
    {pipeline, taker} = at(fused)
    from = of_pipeline(pipeline, stream)

    asked = %{
      taker: taker,
      stream: from,
      policy: policy,
      request: {key, request},
      input: &input/1
    }

    Pipeline.Client.call(pipeline, {:attach, asked})
  end

  @doc "Removes an input, see `Situ.Fusion.remove_input/3`."
  @spec remove(term(), term(), keyword()) ::
          {:ok, Situ.Time.t() | :start} | {:error, Error.t()}
  def remove(fused, key, opts) do
    {pipeline, taker} = at(fused)
    Pipeline.Client.call(pipeline, {:detach, %{taker: taker, request: {key, opts}}})
  end

  defp input(index), do: :"s#{index}"

  defp at(%Stream{} = stream), do: {stream.pipeline, {stream.node, stream.output}}
  defp at({pipeline, name}) when is_binary(name), do: {pipeline, name}

  defp at(other) do
    takes = "the stream of a join, fusion or merge, or {pipeline, its_name}"
    Argument.refuse!(other, takes, "Situ.add_input(joined, :left, stream)")
  end

  defp of_pipeline(_pipeline, name) when is_binary(name), do: name

  defp of_pipeline(_pipeline, other) when not is_struct(other, Stream) do
    takes = "a stream, or its name, as its third argument"
    Argument.refuse!(other, takes, "Situ.add_input(joined, :left, stream)")
  end

  defp of_pipeline(pipeline, stream) do
    if Pipeline.Client.pid(pipeline) == stream.pipeline.pid do
      {stream.node, stream.output}
    else
      raise Error.new(
              :different_pipeline,
              "stream #{inspect(stream.name)} belongs to another pipeline",
              fix: "carry the stream over with Situ.Connector"
            )
    end
  end
end
