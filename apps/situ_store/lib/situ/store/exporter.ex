defmodule Situ.Store.Exporter do
  @moduledoc """
  A store being written by a pipeline: what `Situ.Store.create/4` returns and `Situ.Store.write/4` takes.

  The store is closed when the pipeline has completed, whether it ended well or by an error.
  """
  alias Situ.{Pipeline, Stream}
  alias Situ.Store.{Keys, Sink, Volatile, Writer}

  @enforce_keys [:writer, :users]
  defstruct [:writer, :users, eager: false]
  @type t :: %__MODULE__{writer: Writer.t(), users: :atomics.atomics_ref(), eager: boolean()}

  @doc false
  @spec create(Pipeline.t(), String.t(), Path.t() | nil, keyword()) :: t()
  def create(%Situ.Graph.Handle{} = p, name, root, opts) do
    {root, opts} =
      if root in [nil, ""],
        do: {Volatile.root(), [{:volatile, true} | opts]},
        else: {Path.expand(root), opts}

    case Writer.create(name, root, opts) do
      {:ok, writer} ->
        exporter = %__MODULE__{
          writer: writer,
          users: :atomics.new(1, signed: true),
          eager: opts[:durability] == :each
        }

        :ok = Pipeline.on(p, :completed, fn _report -> close(exporter) end)
        :ok = Pipeline.on(p, :abandoned, fn _error -> give_up(exporter) end)
        exporter

      {:error, error} ->
        raise error
    end
  end

  @doc false
  @spec write(Stream.t(), t(), String.t(), keyword()) :: Stream.t()
  def write(%Stream{} = stream, %__MODULE__{} = exporter, name, opts) do
    {common, opts} = Keyword.split(opts, [:policy, :name, :on_error])

    # Nothing is lost on the way to disk unless the caller says so, whatever the pipeline's default policy.
    common = Keyword.put_new(common, :policy, Situ.Delivery.unlimited())
    {envelopes, opts} = Keyword.pop(opts, :envelopes, false)
    {keys, opts} = Keyword.pop(opts, :keys, false)
    opts = Keyword.put_new(opts, :type, if(envelopes, do: :any, else: stream.type))

    case Writer.stream(exporter.writer, name, opts) do
      {:ok, writer_stream} ->
        :atomics.add(exporter.users, 1, 1)

        Situ.via(
          stream,
          Sink,
          [
            exporter: exporter,
            stream: writer_stream,
            envelopes: envelopes,
            eager: exporter.eager
          ],
          # A lossy default of the pipeline does not thin out its recording.
          [policy: Situ.Delivery.unlimited(), name: "Write " <> String.replace(name, ".", " ")]
          |> Keyword.merge(common)
        )

        if keys, do: note_keys(stream, exporter, writer_stream, opts[:metadata])
        stream

      {:error, error} ->
        raise error
    end
  end

  defp note_keys(stream, exporter, writer_stream, metadata) do
    :atomics.add(exporter.users, 1, 1)
    options = [exporter: exporter, stream: writer_stream, metadata: metadata || %{}]
    name = "Keys " <> String.replace(writer_stream.name, ".", " ")
    Situ.via(stream, Keys, options, name: name, policy: Situ.Delivery.unlimited())
  end

  @doc false
  def release(%__MODULE__{} = exporter) do
    if :atomics.sub_get(exporter.users, 1, 1) == 0, do: close(exporter), else: :ok
  end

  # Nobody is left to be told of a failure here, and what was committed is safe.
  defp close(exporter), do: Writer.close(exporter.writer)

  # The pipeline never ran: a recording of nothing would only stand in the way of the one before it.
  defp give_up(%{writer: writer} = exporter) do
    _ = close(exporter)

    with {:ok, store} <- Situ.Store.open(writer.path),
         nil <- Situ.Store.interval(store),
         do: Situ.Store.delete(writer.path)
  end
end
