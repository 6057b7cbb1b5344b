defmodule Situ.Chat.ResponseReader do
  @moduledoc false
  # Collects one successful response of a service from its events (`Situ.Infer.Http`), and decides the outcome: an
  # answer, an error, or another attempt. Pure.
  alias Situ.Chat.{Answer, ServerSentEvents}
  alias Situ.Error

  # The maximum size of a response that is not streamed.
  @most_bytes 4_194_304

  defstruct stream?: false,
            events: nil,
            body: [],
            bytes: 0,
            answer: nil,
            text_emitted?: false,
            done?: false,
            error: nil

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{events: ServerSentEvents.new(), answer: Answer.empty_partial()}

  @doc "Adds an event and returns its text; `:halt` means that the reply is complete."
  @spec add_event(t(), Situ.Infer.Http.event()) :: {:cont | :halt, [String.t()], t()}
  def add_event(reply, {:status, _status, headers}) do
    type = headers |> Map.new() |> Map.get("content-type", "")
    {:cont, [], %{reply | stream?: String.contains?(type, "event-stream")}}
  end

  def add_event(%{stream?: true} = reply, {:data, bytes}) do
    case ServerSentEvents.push(reply.events, bytes) do
      {:ok, found, events} -> add_stream_data(found, [], %{reply | events: events})
      {:error, :too_long} -> {:halt, [], %{reply | error: too_long()}}
    end
  end

  def add_event(reply, {:data, bytes}) do
    reply = %{reply | body: [reply.body, bytes], bytes: reply.bytes + byte_size(bytes)}

    if reply.bytes > @most_bytes,
      do: {:halt, [], %{reply | error: too_long()}},
      else: {:cont, [], reply}
  end

  defp too_long,
    do: Error.new(:too_long, "the service's response is too long", fix: "set max_tokens:")

  defp add_stream_data([], texts, reply), do: {:cont, Enum.reverse(texts), reply}

  defp add_stream_data(["[DONE]" | _], texts, reply),
    do: {:halt, Enum.reverse(texts), %{reply | done?: true}}

  defp add_stream_data([json | rest], texts, reply) do
    case Answer.add_event(reply.answer, json) do
      {:ok, more, answer} ->
        reply = %{reply | answer: answer, text_emitted?: reply.text_emitted? or more != []}
        add_stream_data(rest, Enum.reverse(more, texts), reply)

      {:error, error} ->
        {:halt, Enum.reverse(texts), %{reply | error: error}}
    end
  end

  @doc """
  Returns the result. `failure` is the reason why the connection ended early, if it did. `{:retry, error}` asks for
  another attempt. Once text has been emitted, the result is an error instead.
  """
  @spec build_result(t(), Error.t() | nil) ::
          {:ok, Answer.t()} | {:retry, Error.t()} | {:error, Error.t()}
  def build_result(%{text_emitted?: true} = reply, %Error{} = failure),
    do: {:error, put_partial_text(failure, reply)}

  def build_result(_reply, %Error{} = failure), do: {:retry, failure}

  def build_result(%{error: %Error{} = error} = reply, nil),
    do: {:error, put_partial_text(error, reply)}

  # Some services end the stream without `[DONE]`, but no service ends it before the finish reason.
  def build_result(%{stream?: true, answer: answer} = reply, nil) do
    if reply.done? or answer.finish != nil,
      do: {:ok, Answer.to_answer(answer)},
      else:
        build_result(
          reply,
          Error.new(:cut_off, "the service's response ended before it was complete")
        )
  end

  def build_result(reply, nil) do
    case Answer.add_event(reply.answer, IO.iodata_to_binary(reply.body)) do
      {:ok, _, answer} -> {:ok, Answer.to_answer(answer)}
      error -> error
    end
  end

  defp put_partial_text(error, reply),
    do: %{error | meta: Map.put(error.meta, :text, IO.iodata_to_binary(reply.answer.text))}
end
