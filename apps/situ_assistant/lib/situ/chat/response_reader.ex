defmodule Situ.Chat.ResponseReader do
  @moduledoc false
  # Collects one response of a service from its events (`Situ.Infer.Http`) and decides the outcome: an answer, an error,
  # or another attempt. Pure.
  alias Situ.Chat.{Answer, ServerSentEvents}
  alias Situ.Error

  # At most this many bytes of an error response are read.
  @complaint_bytes 65_536
  @longest_wait_s 30
  # These statuses are temporary, so the request is worth repeating.
  @again [408, 409, 425, 429, 500, 502, 503, 504, 529]

  defstruct status: nil,
            headers: %{},
            kind: nil,
            events: nil,
            body: [],
            bytes: 0,
            piece: nil,
            spoken?: false,
            done?: false,
            error: nil

  @type t :: %__MODULE__{}

  @spec new() :: t()
  def new, do: %__MODULE__{events: ServerSentEvents.new(), piece: Answer.empty_partial()}

  @doc "Adds an event and returns its text; `:halt` means that the reply is complete."
  @spec add_event(t(), Situ.Infer.Http.event()) :: {:cont | :halt, [String.t()], t()}
  def add_event(reply, {:status, status, headers}) do
    headers = Map.new(headers)
    type = Map.get(headers, "content-type", "")

    kind =
      cond do
        status not in 200..299 -> :complaint
        String.contains?(type, "event-stream") -> :stream
        true -> :whole
      end

    {:cont, [], %{reply | status: status, headers: headers, kind: kind}}
  end

  def add_event(%{kind: :stream} = reply, {:data, bytes}) do
    case ServerSentEvents.push(reply.events, bytes) do
      {:ok, found, events} -> add_stream_data(found, [], %{reply | events: events})
      {:error, :too_long} -> {:halt, [], %{reply | error: too_long()}}
    end
  end

  def add_event(%{kind: kind} = reply, {:data, bytes}) do
    reply = %{reply | body: [reply.body, bytes], bytes: reply.bytes + byte_size(bytes)}

    cond do
      kind == :complaint and reply.bytes > @complaint_bytes -> {:halt, [], reply}
      reply.bytes > 64 * @complaint_bytes -> {:halt, [], %{reply | error: too_long()}}
      true -> {:cont, [], reply}
    end
  end

  defp too_long,
    do: Error.new(:too_long, "the service's response is too long", fix: "set max_tokens:")

  defp add_stream_data([], texts, reply), do: {:cont, Enum.reverse(texts), reply}

  defp add_stream_data(["[DONE]" | _], texts, reply),
    do: {:halt, Enum.reverse(texts), %{reply | done?: true}}

  defp add_stream_data([json | rest], texts, reply) do
    case Answer.add_event(reply.piece, json) do
      {:ok, more, piece} ->
        reply = %{reply | piece: piece, spoken?: reply.spoken? or more != []}
        add_stream_data(rest, Enum.reverse(more, texts), reply)

      {:error, error} ->
        {:halt, Enum.reverse(texts), %{reply | error: error}}
    end
  end

  @doc """
  Returns the result. `failure` is the reason why the connection ended early, if it did. `{:again, ms | nil, error}`
  asks for another attempt, after `ms` milliseconds if the service specified a delay. Once text has been emitted, the
  result is an error instead of another attempt.
  """
  @spec build_result(t(), Error.t() | nil) ::
          {:ok, Answer.t()} | {:again, non_neg_integer() | nil, Error.t()} | {:error, Error.t()}
  def build_result(%{spoken?: true} = reply, %Error{} = failure),
    do: {:error, put_partial_text(failure, reply)}

  def build_result(_reply, %Error{code: code} = failure)
      when code in [:no_connection, :timeout, :cut_off],
      do: {:again, nil, failure}

  def build_result(_reply, %Error{} = failure), do: {:error, failure}

  def build_result(%{error: %Error{} = error} = reply, nil),
    do: {:error, put_partial_text(error, reply)}

  def build_result(%{kind: :whole} = reply, nil) do
    case Answer.add_event(reply.piece, IO.iodata_to_binary(reply.body)) do
      {:ok, _, piece} -> {:ok, Answer.to_answer(piece)}
      error -> error
    end
  end

  # Some services end the stream without `[DONE]`, but no service ends it before the finish reason.
  def build_result(%{kind: :stream, piece: piece} = reply, nil) do
    if reply.done? or piece.finish != nil,
      do: {:ok, Answer.to_answer(piece)},
      else:
        build_result(
          reply,
          Error.new(:cut_off, "the service's response ended before it was complete")
        )
  end

  def build_result(%{kind: :complaint, status: status} = reply, nil) do
    error = refusal_error(status, reply.body |> IO.iodata_to_binary() |> body_error_text())
    if status in @again, do: {:again, retry_delay_ms(reply.headers), error}, else: {:error, error}
  end

  defp put_partial_text(error, reply),
    do: %{error | meta: Map.put(error.meta, :text, IO.iodata_to_binary(reply.piece.text))}

  # HTML error pages are not readable in an error message, so they are dropped.
  defp body_error_text(body) do
    case Situ.JSON.decode(body) do
      {:ok, json} ->
        Answer.error_text(json)

      _ ->
        if(String.valid?(body) and not (body =~ "<"), do: String.trim(body))
        |> Answer.error_text()
    end
  end

  defp refusal_error(status, _complaint) when status in [401, 403] do
    # The service's error text may contain the key, so it is not shown.
    Error.new(:refused, "the service rejected the key (HTTP #{status})",
      fix: "set the environment variable named by key: to a key that may use this model"
    )
  end

  defp refusal_error(status, _complaint) when status in [301, 302, 303, 307, 308] do
    Error.new(:refused, "the service redirects to a different URL (HTTP #{status})",
      why: "redirects are not followed, because the question and the key are sent only to url:",
      fix: "set url: to the new address (perhaps https:// instead of http://)"
    )
  end

  defp refusal_error(status, complaint) when status in @again,
    do: Error.new(:service_failed, "the service failed (HTTP #{status}): #{complaint}")

  defp refusal_error(status, complaint) do
    Error.new(:refused, "the service rejected the request (HTTP #{status}): #{complaint}",
      fix: "check the URL and the model name"
    )
  end

  defp retry_delay_ms(%{"retry-after" => text}) do
    case Integer.parse(text) do
      {s, ""} when s >= 0 -> min(s, @longest_wait_s) * 1_000
      _ -> nil
    end
  end

  defp retry_delay_ms(_headers), do: nil
end
