defmodule Situ.Chat.Answer do
  @moduledoc """
  The answer of a language model: `text`, the requested tool calls (`calls`), why it ended (`finish`), and the number of
  tokens read and written (`tokens`). `exact?` is false if the service reported no numbers and they were counted here.

  `finish` is `:stop`, `:length` (cut off at the maximum length), `:calls` (the model waits for the tools), `:filtered`
  or `:cancelled`.

  It is built from the events of a stream:

      iex> alias Situ.Chat.Answer
      iex> event = fn text -> ~s({"choices":[{"delta":{"content":"\#{text}"},"finish_reason":"stop"}]}) end
      iex> {:ok, ["Hel"], piece} = Answer.add_event(Answer.empty_partial(), event.("Hel"))
      iex> {:ok, ["lo"], piece} = Answer.add_event(piece, event.("lo"))
      iex> answer = Answer.to_answer(piece)
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
  @type piece :: %{
          text: iodata(),
          bytes: non_neg_integer(),
          count: non_neg_integer(),
          calls: %{non_neg_integer() => {String.t(), String.t(), iodata()}},
          places: %{integer() => non_neg_integer()},
          finish: finish() | nil,
          usage: tokens() | nil
        }

  @doc "Returns a partial answer without content."
  @spec empty_partial() :: piece()
  def empty_partial,
    do: %{text: [], bytes: 0, count: 0, calls: %{}, places: %{}, finish: nil, usage: nil}

  @doc "Adds one streamed event (or a complete, non-streamed response) and returns the text it adds."
  @spec add_event(piece(), binary()) :: {:ok, [String.t()], piece()} | {:error, Error.t()}
  def add_event(piece, json) do
    case decode_event(json) do
      {:ok, %{"error" => error}} when error not in [nil, false] ->
        {:error, Error.new(:service_failed, "the service failed: #{Refusal.error_text(error)}")}

      {:ok, %{} = event} ->
        event |> first_choice() |> add_choice(put_usage(piece, event["usage"])) |> check_size()

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
  @spec to_answer(piece()) :: t()
  def to_answer(piece) do
    calls = for {_, {id, name, raw}} <- Enum.sort(piece.calls), do: build_call(id, name, raw)
    counted = %{read: 0, written: piece.count}

    %__MODULE__{
      text: IO.iodata_to_binary(piece.text),
      calls: calls,
      finish: if(calls != [], do: :calls, else: piece.finish || :stop),
      tokens: piece.usage || counted,
      exact?: piece.usage != nil
    }
  end

  defp build_call(id, name, raw), do: ToolCall.new(id, name, IO.iodata_to_binary(raw))

  defp first_choice(%{"choices" => [%{} = choice | _]}), do: choice
  defp first_choice(_), do: %{}

  defp add_choice(choice, piece) do
    said = choice_delta(choice)
    text = if is_binary(said["content"]), do: said["content"], else: ""
    calls = if is_list(said["tool_calls"]), do: said["tool_calls"], else: []

    piece = %{
      piece
      | text: [piece.text, text],
        bytes: piece.bytes + byte_size(text),
        count: piece.count + if(text == "", do: 0, else: 1),
        finish: parse_finish(choice["finish_reason"]) || piece.finish
    }

    {if(text == "", do: [], else: [text]),
     calls |> Enum.with_index() |> Enum.reduce(piece, &add_call_delta/2)}
  end

  defp choice_delta(%{"delta" => %{} = said}), do: said
  defp choice_delta(%{"message" => %{} = said}), do: said
  defp choice_delta(_), do: %{}

  # The parts of a call have its number; the first part has the id and the name. Some services number every call 0 or
  # not at all, so a different id starts a new call. Some repeat the id and the name in every part.
  defp add_call_delta({%{} = part, nth}, piece) do
    number = if is_integer(part["index"]), do: part["index"], else: nth
    place = call_position(piece, number, string_or_empty(part["id"]))
    function = if is_map(part["function"]), do: part["function"], else: %{}
    {id, name, raw} = Map.get(piece.calls, place, {"", "", []})
    more = string_or_empty(function["arguments"])

    now =
      {append_new(id, string_or_empty(part["id"])),
       append_new(name, string_or_empty(function["name"])), [raw, more]}

    %{
      piece
      | calls: Map.put(piece.calls, place, now),
        places: Map.put(piece.places, number, place),
        bytes: piece.bytes + byte_size(more) + 16
    }
  end

  defp add_call_delta(_, piece), do: piece

  # Positions follow the order in which the calls arrived.
  defp call_position(%{places: places, calls: calls}, number, id) do
    with place when place != nil <- places[number],
         {known, _, _} when known == id or id == "" or known == "" <- calls[place] do
      place
    else
      _ -> find_call(calls, id) || map_size(calls)
    end
  end

  defp find_call(_calls, ""), do: nil

  defp find_call(calls, id),
    do: Enum.find_value(calls, fn {place, {known, _, _}} -> known == id && place end)

  defp append_new(text, text), do: text
  defp append_new(known, text), do: known <> text

  defp string_or_empty(text) when is_binary(text), do: text
  defp string_or_empty(_), do: ""

  defp check_size({_, %{bytes: bytes}}) when bytes > @most_bytes, do: too_long()
  defp check_size({_, %{calls: calls}}) when map_size(calls) > @most_calls, do: too_long()
  defp check_size({texts, piece}), do: {:ok, texts, piece}

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

  defp put_usage(piece, %{"prompt_tokens" => read} = usage) when is_integer(read) and read >= 0 do
    written = usage["completion_tokens"]
    written = if is_integer(written) and written >= 0, do: written, else: piece.count
    %{piece | usage: %{read: read, written: written}}
  end

  defp put_usage(piece, _), do: piece
end
