defmodule Situ.Pipeline.Tap do
  @moduledoc """
  A look at a stream of a running pipeline, attached and detached while it runs; see `Situ.attach_tap/3`.

  The function runs in a process of its own behind a lossy queue (default `Situ.Delivery.max_queue(1_000)`), so a slow
  or stuck tap costs the pipeline nothing but the copy of the messages. A tap that raises skips the message. It goes
  with its pipeline, and with the process that attached it.

      iex> me = self()
      iex> connector = Situ.Connector.new("taps")
      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(connector) |> Situ.map(&(&1 * 2), name: "Doubled")
      ...> end, [])
      iex> {:ok, tap} = Situ.attach_tap({p, "Doubled"}, &send(me, {:seen, &1.data}))
      iex> Situ.Connector.deliver(connector, [%Situ.Message{data: 21, originating_time: 1}])
      iex> receive do {:seen, n} -> n end
      42
      iex> Situ.Pipeline.Tap.detach(tap)
      :ok
      iex> {:ok, _} = Situ.Pipeline.stop(p)
      iex> Situ.Pipeline.Tap.detach(tap)
      :ok
  """
  alias Situ.Pipeline.Client

  @enforce_keys [:pipeline, :id]
  defstruct [:pipeline, :id]

  @type t :: %__MODULE__{pipeline: pid(), id: pos_integer()}

  @schema [
    policy: [
      type: {:struct, Situ.Delivery},
      doc: "The delivery policy of its queue; default `Situ.Delivery.max_queue(1_000)`."
    ],
    name: [type: :string, doc: "Its name in diagnostics; default \"Tap\"."]
  ]

  @doc false
  def schema, do: @schema

  @doc false
  @spec attach(
          Situ.Stream.t() | {Situ.Pipeline.target(), String.t()},
          (Situ.Message.t() -> any()),
          keyword()
        ) ::
          {:ok, t()} | {:error, Situ.Error.t()}
  def attach(target, fun, opts) when is_function(fun, 1) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      {pipeline, which} = which(target)
      asked = %{stream: which, component: {__MODULE__.Sink, [fun: fun]}, opts: opts}

      with {:ok, {pid, id}} <- Client.call(pipeline, {:tap, asked}),
           do: {:ok, %__MODULE__{pipeline: pid, id: id}}
    end
  end

  @doc "Takes the tap away; a tap whose pipeline has ended is gone already."
  @spec detach(t()) :: :ok
  def detach(%__MODULE__{} = tap) do
    case Client.call(tap.pipeline, {:untap, tap.id}) do
      :ok -> :ok
      {:error, %Situ.Error{code: :not_running}} -> :ok
    end
  end

  defp which(%Situ.Stream{} = stream), do: {stream, {stream.node, stream.output}}
  defp which({pipeline, name}) when is_binary(name), do: {pipeline, name}
end

defmodule Situ.Pipeline.Tap.Sink do
  @moduledoc false
  # The component behind a tap.
  use Situ.Component, inputs: [in: :any], options: [fun: [type: {:fun, 1}, required: true]]

  @impl true
  def init(opts), do: {:ok, opts[:fun]}

  @impl true
  def handle_message(:in, message, _context, fun) do
    fun.(message)
    {[], fun}
  end
end
