defmodule Situ.Subscription do
  @moduledoc """
  Delivers the messages of a stream of a running pipeline to a process that shows or forwards them, such as a LiveView
  or a cell of a notebook. At most one message waits for the process. While it is busy, newer messages replace each
  other, and the pipeline never waits.

      iex> build = &Situ.sequence(&1, 1, fn n -> n + 1 end, every: Situ.Time.ms(1), name: "Count")
      iex> {:ok, p} = Situ.Pipeline.start(build)
      iex> {:ok, subscription} = Situ.Subscription.start_link({p, "Count"}, every: 0)
      iex> receive do: ({:situ, "Count", %Situ.Message{data: n}} -> is_integer(n))
      true
      iex> Situ.Subscription.request_next(subscription)
      :ok
      iex> Situ.Subscription.stop(subscription)
      :ok
      iex> {:ok, _report} = Situ.Pipeline.stop(p)

  The process receives `{:situ, tag, event}`, where `event` is one of:

    * a `Situ.Message`; the process then calls `request_next/1`
    * `:ended` when the pipeline has ended. A target that is a name or a function is looked up again, so a pipeline that
      its supervisor restarts is followed; a pid is not
    * a `Situ.Error` if the pipeline or the stream does not exist

  The subscription is linked to the process that starts it and ends with it. It is a tap (`Situ.attach_tap/3`).
  """
  use GenServer

  alias Situ.{Error, Message, Tap}

  @schema [
    tag: [
      type: :any,
      default: nil,
      doc: "The second element of the events; default: the stream's name."
    ],
    every: [
      type: :non_neg_integer,
      default: 33,
      doc: "The minimum time between two messages in milliseconds."
    ],
    deliver: [
      type: {:optional, {:fun, 1}},
      default: nil,
      doc: "A function that is called with each event, instead of sending it to the process."
    ]
  ]
  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  @typedoc "A pipeline, or a function that finds it, with the name of a stream."
  @type target :: {Situ.Pipeline.target() | (() -> Situ.Pipeline.target() | nil), String.t()}
  @type event :: Message.t() | :ended | Error.t()

  @retry_ms 500

  @doc "Starts a subscription for the calling process."
  @spec start_link(target(), keyword()) :: GenServer.on_start()
  def start_link({_pipeline, stream} = target, opts \\ []) when is_binary(stream) do
    opts = Situ.Options.validate!(opts, @schema)
    owner = self()
    tag = opts[:tag] || stream
    deliver = opts[:deliver] || (&send(owner, {:situ, tag, &1}))
    GenServer.start_link(__MODULE__, {target, owner, deliver, opts[:every]})
  end

  @doc "Asks for the next message: the latest one, now or when it arrives."
  @spec request_next(pid()) :: :ok
  def request_next(subscription), do: GenServer.cast(subscription, :next)

  @doc "Ends a subscription."
  @spec stop(pid()) :: :ok
  def stop(subscription), do: GenServer.stop(subscription)

  @impl true
  def init({target, owner, deliver, every_ms}) do
    Process.flag(:trap_exit, true)

    state = %{
      target: target,
      owner: owner,
      deliver: deliver,
      every_ms: every_ms,
      tap: nil,
      latest: nil,
      next?: true,
      timer: nil,
      told: nil
    }

    {:ok, state, {:continue, :attach}}
  end

  @impl true
  def handle_continue(:attach, state), do: {:noreply, attach_tap(state)}

  defp attach_tap(%{target: {pipeline, stream}} = state) do
    me = self()

    case attach_to({resolve_pipeline(pipeline), stream}, &send(me, {:message, &1})) do
      {:ok, tap} ->
        Process.monitor(tap.pipeline)
        %{state | tap: tap, told: nil}

      {:error, error} ->
        retry_later(pipeline)
        report_event(state, error)
    end
  end

  defp attach_to({nil, _stream}, _fun), do: {:error, not_running_error()}

  # The pipeline may end at any time.
  defp attach_to({pipeline, stream}, fun) do
    Tap.attach({pipeline, stream}, fun, name: "Subscription: " <> stream)
  catch
    :exit, _ -> {:error, not_running_error()}
  end

  defp not_running_error, do: Error.new(:not_running, "the pipeline is not running")

  # The process that the function calls may have exited.
  defp resolve_pipeline(find) when is_function(find, 0) do
    find.()
  catch
    :exit, _ -> nil
  end

  defp resolve_pipeline(pipeline), do: pipeline

  defp retry_later(pipeline) when is_pid(pipeline) or is_struct(pipeline), do: :ok
  defp retry_later(_name), do: Process.send_after(self(), :attach, @retry_ms)

  # An error that is found again at each attempt is reported once.
  defp report_event(%{told: code} = state, %Error{code: code}), do: state

  defp report_event(state, event) do
    state.deliver.(event)
    %{state | told: if(event == :ended, do: :not_running, else: event.code)}
  end

  @impl true
  def handle_cast(:next, state), do: {:noreply, deliver_latest(%{state | next?: true})}

  @impl true
  def handle_info({:message, message}, state),
    do: {:noreply, deliver_latest(%{state | latest: message})}

  def handle_info(:due, state), do: {:noreply, deliver_latest(%{state | timer: nil})}
  def handle_info(:attach, state), do: {:noreply, attach_tap(state)}

  def handle_info({:DOWN, _, :process, _, _}, %{target: {pipeline, _}} = state) do
    retry_later(pipeline)
    {:noreply, report_event(%{state | tap: nil}, :ended)}
  end

  def handle_info({:EXIT, owner, _reason}, %{owner: owner} = state), do: {:stop, :normal, state}
  def handle_info(_other, state), do: {:noreply, state}

  defp deliver_latest(%{latest: %Message{} = message, next?: true, timer: nil} = state) do
    state.deliver.(message)
    timer = if state.every_ms > 0, do: Process.send_after(self(), :due, state.every_ms)
    %{state | latest: nil, next?: false, timer: timer}
  end

  defp deliver_latest(state), do: state

  @impl true
  def terminate(_reason, %{tap: nil}), do: :ok

  def terminate(_reason, %{tap: tap}) do
    Tap.detach(tap)
  catch
    :exit, _ -> :ok
  end
end
