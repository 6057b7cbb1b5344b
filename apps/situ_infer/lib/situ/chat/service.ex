defmodule Situ.Chat.Service do
  @own [
    url: [
      type: :string,
      default: "http://127.0.0.1:11434/v1",
      doc:
        "Where the service is; `/chat/completions` follows its path (and `?api-version=...` stays behind that)."
    ],
    model: [type: :string, required: true, doc: "Which model is to answer."],
    key: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The **name** of the environment variable that holds the key, such as \"OPENAI_API_KEY\"; `nil`: none is sent."
    ],
    key_header: [
      type: {:in, [:bearer, :api_key]},
      default: :bearer,
      doc: "How the key is sent: `authorization: Bearer`, or `api-key` (Azure)."
    ],
    temperature: [
      type: {:optional, {:range, 0, 2}},
      default: nil,
      doc: "How freely it chooses words; `nil`: as the service likes."
    ],
    max_tokens: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The most it may write in one answer."
    ],
    usage: [
      type: :boolean,
      default: true,
      doc: "Ask for the count of tokens; `false` for services that refuse the question."
    ],
    retries: [
      type: :non_neg_integer,
      default: 3,
      doc: "How often a request that failed before its first word is tried again."
    ],
    backoff: [
      type: :pos_integer,
      default: 500,
      doc: "The first wait before that, ms; it doubles each time, up to 30 s."
    ]
  ]
  @schema @own ++ Situ.Infer.Http.schema()

  @moduledoc """
  A language model behind an OpenAI-compatible service, as one knows it: where, which model, whose key, how patient.

  Keys are read from the environment at the moment they are sent, and are nowhere else: not in options, states, errors,
  logs or URLs. A key goes only over TLS, or to this machine.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  alias Situ.Chat.{Answer, Reply, Tool, Turn}
  alias Situ.Error
  alias Situ.Infer.{Http, Service}

  @enforce_keys [:opts]
  defstruct [:opts]
  @type t :: %__MODULE__{opts: map()}

  @doc "The options' schema, for those that pass them on."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "A service by its options; nothing is connected."
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, url} <- Http.parse(opts[:url]),
         :ok <- Service.private(url, opts[:key]),
         do: {:ok, %__MODULE__{opts: Map.new(opts)}}
  end

  @doc """
  Asks with all turns of a conversation; `say` is called with each piece of text as it comes. Errors: those of
  `Situ.Infer.Http`, `:no_key`, `:refused` (the service does not want to: wrong key, no such model), `:service_failed`,
  `:too_long`.
  """
  @spec ask(t(), [Turn.t()], [Tool.t()], (String.t() -> any())) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def ask(%__MODULE__{opts: opts}, turns, tools, say) do
    with {:ok, key} <- key(opts) do
      headers = [{"content-type", "application/json"}, {"accept", "text/event-stream"} | key]
      body = Situ.JSON.encode(body(opts, turns, tools))
      with {:error, error} <- attempt(opts, headers, body, say, 0), do: {:error, hide(error, key)}
    end
  end

  # A service may repeat what it was sent.
  defp hide(error, []), do: error

  defp hide(error, [{_, key}]), do: Service.hide(error, String.replace_prefix(key, "Bearer ", ""))

  defp key(%{key: nil}), do: {:ok, []}

  defp key(%{key: name, key_header: how}) do
    with {:ok, key} <- Service.key(name) do
      if how == :bearer,
        do: {:ok, [{"authorization", "Bearer " <> key}]},
        else: {:ok, [{"api-key", key}]}
    end
  end

  defp body(opts, turns, tools) do
    %{
      model: opts.model,
      stream: true,
      messages: Enum.map(turns, &Turn.to_json/1),
      temperature: opts.temperature,
      max_tokens: opts.max_tokens,
      stream_options: if(opts.usage, do: %{include_usage: true}),
      tools: if(tools != [], do: Enum.map(tools, &Tool.to_json/1))
    }
    |> Map.reject(fn {_, value} -> value == nil end)
  end

  defp attempt(opts, headers, body, say, tries) do
    case once(opts, headers, body, say) do
      {:again, wait, _error} when tries < opts.retries ->
        # The process of one question waits here; cancelling the question ends it.
        Process.sleep(wait || Service.pause(opts.backoff, tries))
        attempt(opts, headers, body, say, tries + 1)

      {:again, _wait, error} ->
        {:error, error}

      result ->
        result
    end
  end

  defp once(opts, headers, body, say) do
    limits = Keyword.new(Map.take(opts, Keyword.keys(Http.schema())))
    url = Service.join(opts.url, "/chat/completions")

    take = fn event, reply ->
      {how, texts, reply} = Reply.take(reply, event)
      Enum.each(texts, say)
      {how, reply}
    end

    case Http.request(:post, url, headers, body, limits, take, Reply.new()) do
      {:ok, reply} -> Reply.close(reply, nil)
      {:error, error, reply} -> Reply.close(reply, error)
    end
  end
end
