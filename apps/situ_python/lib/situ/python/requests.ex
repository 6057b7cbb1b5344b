defmodule Situ.Python.Requests do
  @moduledoc false
  # Requests of a component to its worker that wait for the reply: a snapshot of the state, and its restoration.
  alias Situ.Error
  alias Situ.Python.Worker

  # A checkpoint waits for 5 s by default.
  @timeout 5_000

  @doc """
  Sends a request and returns the reply with the events before it, in order. These events are also sent to the calling
  process again, because it has to handle them as usual.
  """
  @spec call_worker(pid() | nil, iodata()) ::
          {:ok, binary() | nil, [tuple()]} | {:error, Error.t()}
  def call_worker(nil, _frame),
    do: {:error, Error.new(:python_ended, "the worker is not running")}

  def call_worker(worker, frame) do
    ref = make_ref()
    Worker.send_request(worker, ref, frame)
    {reply, events} = await_reply(worker, ref, [])
    for event <- events, do: send(self(), {:situ_python, worker, event})
    with {:ok, bytes} <- reply, do: {:ok, bytes, events}
  end

  defp await_reply(worker, ref, events) do
    receive do
      {:situ_python, ^worker, {:reply, ^ref, reply}} ->
        {reply, Enum.reverse(events)}

      {:situ_python, ^worker, {:ended, error} = event} ->
        {{:error, error}, Enum.reverse([event | events])}

      {:situ_python, ^worker, event} ->
        await_reply(worker, ref, [event | events])
    after
      @timeout -> {{:error, late_error()}, Enum.reverse(events)}
    end
  end

  defp late_error do
    Error.new(:timeout, "the worker did not reply within #{@timeout} ms",
      why: "it was still handling messages"
    )
  end

  @doc "There are results that must be emitted before a snapshot."
  @spec not_settled_error() :: Error.t()
  def not_settled_error, do: Error.new(:not_settled, "the worker was still handling messages")

  @doc "Describes the reason for a missing snapshot."
  @spec no_snapshot_error(String.t(), Error.t()) :: Error.t()
  def no_snapshot_error(class, error) do
    Error.new(:no_snapshot, "cannot take a snapshot of #{class}: #{error.what}",
      why: error.why,
      fix: "define snapshot(self) and restore(self, data) in #{class}"
    )
  end
end
