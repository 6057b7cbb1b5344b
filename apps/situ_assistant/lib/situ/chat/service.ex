defmodule Situ.Chat.Service do
  @own [
    url: [
      type: :string,
      default: "http://127.0.0.1:11434/v1",
      doc:
        "The URL of the service; `/chat/completions` is appended to its path, before any query (`?api-version=...`)."
    ],
    model: [type: :string, required: true, doc: "The name of the model."],
    key: [
      type: {:optional, :string},
      default: nil,
      doc:
        "The **name** of the environment variable with the key, such as \"OPENAI_API_KEY\"; `nil` sends no key."
    ],
    key_header: [
      type: {:in, [:bearer, :api_key]},
      default: :bearer,
      doc: "How the key is sent: `authorization: Bearer`, or `api-key` (Azure)."
    ],
    temperature: [
      type: {:optional, {:range, 0, 2}},
      default: nil,
      doc: "The sampling temperature; `nil` uses the service's default."
    ],
    max_tokens: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The maximum number of tokens in one answer."
    ],
    usage: [
      type: :boolean,
      default: true,
      doc: "Ask for token counts; use `false` for services that reject this option."
    ],
    retries: [
      type: :non_neg_integer,
      default: 3,
      doc: "How often a request that failed before its first output is retried."
    ],
    backoff: [
      type: :pos_integer,
      default: 500,
      doc: "The delay before the first retry, ms; it doubles each time, up to 30 s."
    ]
  ]
  @schema @own ++ Situ.Infer.Http.schema()

  @moduledoc """
  A connection to a language model on an OpenAI-compatible service: its URL, model, key and retry policy.

  Keys are read from the environment when they are sent, and are not stored in options, states, errors, logs or URLs. A
  key is sent only over TLS or to this machine.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  alias Situ.Chat.{Answer, ResponseReader, Tool, Turn}
  alias Situ.Error
  alias Situ.Infer.{Http, Service}

  @enforce_keys [:opts]
  defstruct [:opts]
  @type t :: %__MODULE__{opts: map()}

  @doc "Returns the schema of the options, for modules that forward them."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "Builds a service from its options, without connecting."
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, url} <- Http.parse_url(opts[:url]),
         :ok <- Service.check_transport(url, opts[:key]),
         do: {:ok, %__MODULE__{opts: Map.new(opts)}}
  end

  @doc """
  Sends all turns of a conversation, and calls `say` with each chunk of text as it arrives. Errors: the errors of
  `Situ.Infer.Http`, `:no_key`, `:refused` (the service rejects the request: wrong key or unknown model),
  `:service_failed`, `:too_long`.
  """
  @spec ask(t(), [Turn.t()], [Tool.t()], (String.t() -> any())) ::
          {:ok, Answer.t()} | {:error, Error.t()}
  def ask(%__MODULE__{opts: opts}, turns, tools, say) do
    with {:ok, key} <- auth_headers(opts) do
      headers = [{"content-type", "application/json"}, {"accept", "text/event-stream"} | key]
      body = Situ.JSON.encode(build_body(opts, turns, tools))

      with {:error, error} <- request_with_retries(opts, headers, body, say, 0),
           do: {:error, hide_key(error, key)}
    end
  end

  # An error text of the service may contain the key.
  defp hide_key(error, []), do: error

  defp hide_key(error, [{_, key}]),
    do: Service.redact_key(error, String.replace_prefix(key, "Bearer ", ""))

  defp auth_headers(%{key: nil}), do: {:ok, []}

  defp auth_headers(%{key: name, key_header: how}) do
    with {:ok, key} <- Service.fetch_key(name) do
      if how == :bearer,
        do: {:ok, [{"authorization", "Bearer " <> key}]},
        else: {:ok, [{"api-key", key}]}
    end
  end

  defp build_body(opts, turns, tools) do
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

  defp request_with_retries(opts, headers, body, say, tries) do
    case send_request(opts, headers, body, say) do
      {:again, wait, _error} when tries < opts.retries ->
        # This blocks only the process of this question, which is killed when the question is cancelled.
        Process.sleep(wait || Service.retry_delay_ms(opts.backoff, tries))
        request_with_retries(opts, headers, body, say, tries + 1)

      {:again, _wait, error} ->
        {:error, error}

      result ->
        result
    end
  end

  defp send_request(opts, headers, body, say) do
    limits = Keyword.new(Map.take(opts, Keyword.keys(Http.schema())))
    url = Service.join_path(opts.url, "/chat/completions")

    take = fn event, reply ->
      {how, texts, reply} = ResponseReader.add_event(reply, event)
      Enum.each(texts, say)
      {how, reply}
    end

    case Http.request(:post, url, headers, body, limits, take, ResponseReader.new()) do
      {:ok, reply} -> ResponseReader.build_result(reply, nil)
      {:error, error, reply} -> ResponseReader.build_result(reply, error)
    end
  end
end
