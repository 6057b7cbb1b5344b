defmodule Situ.Selection.Keeper do
  @moduledoc false
  # Adds a component with one output behind a stream (or several), with the options every operator takes.

  @common [
    name: [type: :string],
    type: [type: :any],
    policy: [type: :any],
    on_error: [type: {:in, [:stop, :skip, :restart]}],
    async: [type: :boolean]
  ]

  @spec add(
          Situ.Stream.t() | keyword(Situ.Stream.t()),
          String.t(),
          module(),
          keyword(),
          {Situ.Type.t(), keyword()}
        ) :: Situ.Stream.t()
  def add(%Situ.Stream{} = stream, name, module, options, rest),
    do: add([in: stream], name, module, options, rest)

  def add([{_, first} | _] = inputs, name, module, options, {type, opts}) do
    opts = Situ.Options.validate!(opts, @common)

    common =
      [
        default_name: name,
        inputs: Enum.map(inputs, fn {input, stream} -> {input, stream.type} end),
        outputs: [out: opts[:type] || type]
      ] ++ Keyword.take(opts, [:name, :on_error, :async])

    node = Situ.Pipeline.add(first.pipeline, module, options, common)

    Enum.each(inputs, fn {input, stream} ->
      Situ.Pipeline.connect(stream, node, input, policy: opts[:policy])
    end)

    Situ.Node.output(node, :out)
  end
end
