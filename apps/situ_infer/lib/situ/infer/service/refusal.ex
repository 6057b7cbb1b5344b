defmodule Situ.Infer.Service.Refusal do
  @moduledoc false
  # An unsuccessful response of a service (`Situ.Infer.Service`): its status, its message, and whether the request is
  # worth repeating.
  alias Situ.Error

  # At most this many bytes of the response are read.
  @most_bytes 65_536
  # These statuses are temporary.
  @temporary [408, 409, 425, 429, 500, 502, 503, 504, 529]

  @enforce_keys [:status, :headers]
  defstruct [:status, :headers, body: ""]
  @type t :: %__MODULE__{status: 100..999, headers: map(), body: binary()}

  @doc "Returns a refusal without a body."
  @spec new(100..999, [Situ.Infer.Http.header()]) :: t()
  def new(status, headers), do: %__MODULE__{status: status, headers: Map.new(headers)}

  @doc "Adds bytes of the body; `:halt` means that it is long enough."
  @spec add_bytes(t(), binary()) :: {:cont | :halt, t()}
  def add_bytes(%__MODULE__{body: body} = refusal, bytes) do
    next = if byte_size(body) + byte_size(bytes) > @most_bytes, do: :halt, else: :cont
    {next, %{refusal | body: body <> bytes}}
  end

  @doc "Returns whether the request may succeed later."
  @spec temporary?(t()) :: boolean()
  def temporary?(%__MODULE__{status: status}), do: status in @temporary

  @doc "Returns the delay in ms that the service asks for, limited to `most`, or `nil`."
  @spec retry_after_ms(t(), pos_integer()) :: non_neg_integer() | nil
  def retry_after_ms(%__MODULE__{headers: headers}, most) do
    case Integer.parse(Map.get(headers, "retry-after", "")) do
      {s, ""} when s >= 0 -> min(s * 1_000, most)
      _ -> nil
    end
  end

  @doc "Builds the error."
  @spec build_error(t()) :: Error.t()
  def build_error(%__MODULE__{status: status}) when status in [401, 403] do
    # The service's message may contain the key, so it is not shown.
    Error.new(:refused, "the service rejected the key (HTTP #{status})",
      fix: "set the environment variable named by key: to a key that may use this service"
    )
  end

  def build_error(%__MODULE__{status: status}) when status in [301, 302, 303, 307, 308] do
    Error.new(:refused, "the service redirects to a different URL (HTTP #{status})",
      why: "redirects are not followed, because the request and the key are sent only to url:",
      fix: "set url: to the new address (perhaps https:// instead of http://)"
    )
  end

  def build_error(%__MODULE__{status: status} = refusal) do
    text = body_text(refusal.body)

    if temporary?(refusal),
      do: Error.new(:service_failed, "the service failed (HTTP #{status}): #{text}"),
      else:
        Error.new(:refused, "the service rejected the request (HTTP #{status}): #{text}",
          fix: "check the URL and the options, such as the name of the model"
        )
  end

  # HTML error pages are not readable in an error message, so they are dropped.
  defp body_text(body) do
    case Situ.JSON.decode(body) do
      {:ok, json} -> error_text(json)
      _ -> error_text(if String.valid?(body) and not (body =~ "<"), do: String.trim(body))
    end
  end

  @doc "Extracts a service's error text from its JSON, shortened to 300 characters."
  @spec error_text(term()) :: String.t()
  def error_text(%{"message" => message}) when is_binary(message), do: error_text(message)
  def error_text(%{"detail" => detail}), do: error_text(detail)
  def error_text(%{"error" => error}), do: error_text(error)
  def error_text([%{"msg" => message} | _]), do: error_text(message)
  def error_text(text) when is_binary(text) and text != "", do: String.slice(text, 0, 300)
  def error_text(_), do: "no reason given"
end
