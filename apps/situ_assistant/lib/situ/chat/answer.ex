defmodule Situ.Chat.Answer do
  @moduledoc """
  The answer of a language model: `text`, the requested tool calls (`calls`, see `Situ.Chat`), why it ended (`finish`),
  and the number of tokens read and written (`tokens`). `exact?` is false if the service reported no numbers and they
  were counted here.

  `finish` is `:stop`, `:length` (cut off at the maximum length), `:calls` (the model waits for the tools), `:filtered`
  or `:cancelled`.

  It is built from the events of a stream:

      iex> alias Situ.Chat.Answer
      iex> event = fn text -> ~s({"choices":[{"delta":{"content":"\#{text}"},"finish_reason":"stop"}]}) end
      iex> {:ok, ["Hel"], partial} = Answer.add_event(Answer.empty_partial(), event.("Hel"))
      iex> {:ok, ["lo"], partial} = Answer.add_event(partial, event.("lo"))
      iex> answer = Answer.to_answer(partial)
      iex> {answer.text, answer.finish}
      {"Hello", :stop}
  """
  alias Situ.Chat.ToolCall
  alias Situ.Error
  alias Situ.Infer.Service.Refusal

  @most_calls 64
  @most_bytes 4_194_304

  @enforce_keys [:text]
  defstruct [:text, calls: [], finish: :stop, tokens: %{read: 0, written: 0}, exact?: false]

  @type finish :: :stop | :length | :calls | :filtered | :cancelled
  @type tokens :: %{read: non_neg_integer(), written: non_neg_integer()}
  @type t :: %__MODULE__{
          text: String.t(),
          calls: [ToolCall.t()],
          finish: finish(),
          tokens: tokens(),
          exact?: boolean()
        }

  @typedoc "An answer that is still being received."
  @type partial :: %{
          text: iodata(),
          bytes: non_neg_integer(),
          count: non_neg_integer(),
          calls: %{non_neg_integer() => {String.t(), String.t(), iodata()}},
          positions: %{integer() => non_neg_integer()},
          finish: finish() | nil,
          usage: tokens() | nil
        }

  @doc "Returns a partial answer without content."
  @spec empty_partial() :: partial()
  def empty_partial,
    do: %{text: [], bytes: 0, count: 0, calls: %{}, positions: %{}, finish: nil, usage: nil}

  @doc "Adds one streamed event (or a complete, non-streamed response) and returns the text it adds."
  @spec add_event(partial(), binary()) :: {:ok, [String.t()], partial()} | {:error, Error.t()}
  def add_event(partial, json) do
    case decode_event(json) do
      {:ok, %{"error" => error}} when error not in [nil, false] ->
        {:error, Error.new(:service_failed, "the service failed: #{Refusal.error_text(error)}")}

      {:ok, %{} = event} ->
        event |> first_choice() |> add_choice(put_usage(partial, event["usage"])) |> check_size()

      _ ->
        {:error,
         Error.new(:bad_response, "the service sent an event that is not valid JSON",
           fix: "check that the URL belongs to an OpenAI-compatible service"
         )}
    end
  end

  # Services that split text between UTF-16 surrogates send lone surrogates, which are replaced by U+FFFD.
  defp decode_event(json) do
    with {:error, _} <- Situ.JSON.decode(json),
         do: lone_surrogate() |> Regex.replace(json, "\\\\ufffd") |> Situ.JSON.decode()
  end

  defp lone_surrogate do
    ~r/\\u[dD][89abAB][[:xdigit:]]{2}  (?! \\u[dD][c-fC-F] ) |
       (?<! \\u[dD][89abAB][[:xdigit:]]{2} )  \\u[dD][c-fC-F][[:xdigit:]]{2}/x
  end

  @doc "Builds the answer after its stream has ended."
  @spec to_answer(partial()) :: t()
  def to_answer(partial) do
    calls = for {_, {id, name, raw}} <- Enum.sort(partial.calls), do: build_call(id, name, raw)
    own_counts = %{read: 0, written: partial.count}

    %__MODULE__{
      text: IO.iodata_to_binary(partial.text),
      calls: calls,
      finish: if(calls != [], do: :calls, else: partial.finish || :stop),
      tokens: partial.usage || own_counts,
      exact?: partial.usage != nil
    }
  end

  defp build_call(id, name, raw), do: ToolCall.new(id, name, IO.iodata_to_binary(raw))

  defp first_choice(%{"choices" => [%{} = choice | _]}), do: choice
  defp first_choice(_), do: %{}

  defp add_choice(choice, partial) do
    delta = choice_delta(choice)
    text = if is_binary(delta["content"]), do: delta["content"], else: ""
    calls = if is_list(delta["tool_calls"]), do: delta["tool_calls"], else: []

    partial = %{
      partial
      | text: [partial.text, text],
        bytes: partial.bytes + byte_size(text),
        count: partial.count + if(text == "", do: 0, else: 1),
        finish: parse_finish(choice["finish_reason"]) || partial.finish
    }

    {if(text == "", do: [], else: [text]),
     calls |> Enum.with_index() |> Enum.reduce(partial, &add_call_delta/2)}
  end

  defp choice_delta(%{"delta" => %{} = delta}), do: delta
  defp choice_delta(%{"message" => %{} = delta}), do: delta
  defp choice_delta(_), do: %{}

  # The parts of a call have its number; the first part has the id and the name. Some services number every call 0 or
  # not at all, so a different id starts a new call. Some repeat the id and the name in every part.
  defp add_call_delta({%{} = part, nth}, partial) do
    number = if is_integer(part["index"]), do: part["index"], else: nth
    position = call_position(partial, number, string_or_empty(part["id"]))
    function = if is_map(part["function"]), do: part["function"], else: %{}
    {id, name, raw} = Map.get(partial.calls, position, {"", "", []})
    more = string_or_empty(function["arguments"])

    now =
      {append_new(id, string_or_empty(part["id"])),
       append_new(name, string_or_empty(function["name"])), [raw, more]}

    %{
      partial
      | calls: Map.put(partial.calls, position, now),
        positions: Map.put(partial.positions, number, position),
        bytes: partial.bytes + byte_size(more) + 16
    }
  end

  defp add_call_delta(_, partial), do: partial

  # Positions follow the order in which the calls arrived.
  defp call_position(%{positions: positions, calls: calls}, number, id) do
    with position when position != nil <- positions[number],
         {known, _, _} when known == id or id == "" or known == "" <- calls[position] do
      position
    else
      _ -> find_call(calls, id) || map_size(calls)
    end
  end

  defp find_call(_calls, ""), do: nil

  defp find_call(calls, id),
    do: Enum.find_value(calls, fn {position, {known, _, _}} -> known == id && position end)

  defp append_new(text, text), do: text
  defp append_new(known, text), do: known <> text

  defp string_or_empty(text) when is_binary(text), do: text
  defp string_or_empty(_), do: ""

  defp check_size({_, %{bytes: bytes}}) when bytes > @most_bytes, do: too_long()
  defp check_size({_, %{calls: calls}}) when map_size(calls) > @most_calls, do: too_long()
  defp check_size({texts, partial}), do: {:ok, texts, partial}

  defp too_long do
    {:error,
     Error.new(:too_long, "the service's response is too long",
       why: "it has more than #{@most_bytes} bytes or #{@most_calls} tool calls",
       fix: "limit it with max_tokens:"
     )}
  end

  defp parse_finish("stop"), do: :stop
  defp parse_finish("length"), do: :length
  defp parse_finish("tool_calls"), do: :calls
  defp parse_finish("content_filter"), do: :filtered
  defp parse_finish(text) when is_binary(text), do: :stop
  defp parse_finish(_), do: nil

  defp put_usage(partial, %{"prompt_tokens" => read} = usage)
       when is_integer(read) and read >= 0 do
    written = usage["completion_tokens"]
    written = if is_integer(written) and written >= 0, do: written, else: partial.count
    %{partial | usage: %{read: read, written: written}}
  end

  defp put_usage(partial, _), do: partial
end
