defmodule Situ.Bridge.Mqtt.Message do
  @moduledoc """
  A message with its topic and the properties of MQTT 5.

  Subscriptions with `envelope: true` return such messages. A stream of them can be published, each on its own topic,
  and with a request's `response_topic` and `correlation_data` it is answered:

      %Situ.Bridge.Mqtt.Message{
        topic: request.response_topic,
        correlation_data: request.correlation_data,
        payload: 21.5
      }

  In `user_properties`, names may occur several times. `message_expiry` is the remaining lifetime in seconds. If the
  broker only supports MQTT 3.1.1, only the topic, the payload, `qos` and `retain?` are transmitted.
  """
  defstruct [
    :topic,
    :payload,
    :qos,
    :content_type,
    :response_topic,
    :correlation_data,
    :message_expiry,
    retain?: false,
    user_properties: []
  ]

  @type t :: %__MODULE__{
          topic: String.t() | nil,
          payload: term(),
          qos: 0..2 | nil,
          retain?: boolean(),
          content_type: String.t() | nil,
          response_topic: String.t() | nil,
          correlation_data: binary() | nil,
          message_expiry: non_neg_integer() | nil,
          user_properties: [{String.t(), String.t()}]
        }

  @properties [
    :content_type,
    :response_topic,
    :correlation_data,
    :message_expiry,
    :user_properties
  ]
  # A stream's originating time, in ns, if the payload does not contain it.
  @time_name "situ-originating-time"

  @doc false
  def time_name, do: @time_name

  @doc false
  @spec to_properties(t()) :: [{atom(), term()}]
  def to_properties(message), do: for(name <- @properties, do: {name, Map.fetch!(message, name)})

  @doc false
  @spec from_publication(map(), payload :: term()) :: t()
  def from_publication(publication, payload) do
    struct!(
      %__MODULE__{
        topic: publication.topic,
        payload: payload,
        qos: publication.qos,
        retain?: publication.retain?
      },
      publication.properties
      |> Map.take(@properties)
      |> Map.update(:user_properties, [], &List.keydelete(&1, @time_name, 0))
    )
  end

  @doc false
  @spec read_time(map()) :: Situ.Time.t() | nil
  def read_time(properties) do
    with {_, text} when byte_size(text) <= 20 <-
           List.keyfind(properties[:user_properties] || [], @time_name, 0),
         {time, ""} when abs(time) < 0x8000_0000_0000_0000 <- Integer.parse(text) do
      time
    else
      _ -> nil
    end
  end
end
