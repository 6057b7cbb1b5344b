defmodule Situ.Live.TemplateTest do
  use ExUnit.Case, async: true
  import Situ.Live.Template
  import Situ.Live.Component, only: [render_slot: 2, link: 1, island: 1]
  import Situ.Live.Test, only: [render_component: 1, render_component: 2]
  alias Situ.Live.Demo.Parts

  defp html(rendered), do: rendered |> Situ.Live.Html.escape() |> Situ.Live.Html.to_html()

  def box(assigns), do: ~H"<div class={@class}>{render_slot(@inner_block, 3)}</div>"

  test "values are escaped in text and attributes" do
    assigns = %{a: "<&\"'>"}

    assert html(~H|<p title={@a}>{@a}</p>|) ==
             "<p title=\"&lt;&amp;&quot;&#39;&gt;\">&lt;&amp;&quot;&#39;&gt;</p>"
  end

  test "text that is not UTF-8 is repaired" do
    assigns = %{a: <<"a", 255, "<">>}
    assert html(~H"<p>{@a}</p>") == "<p>a\uFFFD&lt;</p>"
  end

  test "attributes: nil and false omit, true names, lists join, maps spread" do
    assigns = %{}

    assert html(~H"<input disabled={true} hidden={false} id={nil} class={[\"a\", nil, \"b\"]}>") ==
             "<input disabled class=\"a b\">"

    assert html(~H|<i {%{"data-x" => 1}} {[title: "t"]}></i>|) ==
             "<i data-x=\"1\" title=\"t\"></i>"

    assert_raise ArgumentError, fn -> html(~H|<i {%{"on x=\"" => 1}}></i>|) end
  end

  test "handles braces in expressions, text and scripts, and when switched off" do
    assigns = %{}
    assert html(~H|<b>{%{a: "}"}.a}</b>|) == "<b>}</b>"
    assert html(~H|<b>\{</b>|) == "<b>{</b>"
    assert html(~H|<style>a { color: red }</style>|) == "<style>a { color: red }</style>"
    assert html(~H|<p phx-no-curly-interpolation>{x}</p>|) == "<p>{x}</p>"
    assert html(~H|a < b <%= 1 + 1 %><%!-- gone --%>|) == "a < b 2"
  end

  test ":for with :if filters the list, and :key sets the keys" do
    assigns = %{xs: [1, 2, 3]}
    assert html(~H"<i :for={x <- @xs} :if={x > 1} :key={x}>{x}</i>") == "<i>2</i><i>3</i>"
    %{dynamic: [list]} = ~H"<i :for={x <- @xs} :if={x > 1} :key={x}>{x}</i>"
    assert Enum.map(list.entries, &elem(&1, 0)) == [2, 3]
  end

  test "components support attributes, defaults, rest and slots with arguments" do
    assert render_component(&Parts.card/1, title: "t", "phx-click": "go") ==
             "<section class=\"card plain\" phx-click=\"go\">\n  <h2>t</h2>\n  \n  \n</section>"

    assert_raise ArgumentError, ~r/needs the attr title/, fn ->
      render_component(&Parts.card/1)
    end

    assigns = %{}
    assert html(~H"<.box class=\"x\" :let={n}>{n + 1}</.box>") == "<div class=\"x\">4</div>"
  end

  test "slots support :for and :if" do
    assigns = %{rows: [%{id: 1}], on: false}

    out =
      html(~H"""
      <Parts.table id="t" rows={@rows}>
        <:col :for={n <- 1..2} :let={r} label={"c#{n}"}>{r.id * n}</:col>
        <:col :if={@on} label="off">x</:col>
      </Parts.table>
      """)

    assert out =~ "<th>c1</th><th>c2</th>"
    assert out =~ "<td>2</td>"
    refute out =~ "off"
  end

  test "links reject scripts" do
    assigns = %{}
    assert html(~H|<.link patch="/a?b=1&c">x</.link>|) =~ "href=\"/a?b=1&amp;c\""
    assert_raise ArgumentError, fn -> html(~H|<.link href=" JavaScript:alert(1)">x</.link>|) end
  end

  test "an island is one tag" do
    assigns = %{}
    assert html(~H"<.island><b>x</b></.island>") == "<b>x</b>"
    assert_raise ArgumentError, fn -> html(~H"<.island>x</.island>") end
  end

  test "mistakes are compile errors with line and column" do
    for {source, message} <- [
          {"<p>", "some.ex:4:1"},
          {"<p>", "<p> is not closed"},
          {"<p></b>", "</b> where <p> of line 4 must be closed"},
          {"</b>", "</b> closes nothing"},
          {"<p>{1 +</p>", "some.ex:4:"},
          {"<% if true do %>", "not supported"},
          {"<p :for={x}></p>", ":for requires a generator"},
          {"<p :key={1}></p>", ":key on <p> without :for"},
          {"<p :nope={1}></p>", "expected :if"},
          {"<:slot></:slot>", "must be directly inside a component"},
          {"<p a=1></p>", "must be in quotes or braces"},
          {"<p ", "this tag has no closing >"}
        ] do
      code = "import Situ.Live.Template\nassigns = %{}\n~H\"\"\"\n#{source}\n\"\"\""
      assert syntax_error(code) =~ message
    end
  end

  defp syntax_error(code) do
    Code.eval_string(code, [], file: "some.ex")
    flunk("compiled: " <> code)
  rescue
    error in [SyntaxError, TokenMissingError] -> Exception.message(error)
  end

  test "renders only the parts that read a changed assign" do
    me = self()
    count = fn x -> send(me, {:made, x}) && x end
    render = fn assigns -> ~H"<p>{count.(@a)}{count.(@b)}</p>" end
    # `count` is a variable of the surrounding function, so everything is rendered.
    render.(%{a: 1, b: 2, __changed__: %{a: true}})
    assert_received {:made, 2}

    quiet = fn assigns -> ~H"<p>{send(@pid, @a)}{send(@pid, @b)}</p>" end
    assert %{dynamic: [_, :unchanged]} = quiet.(%{pid: me, a: 11, b: 12, __changed__: %{a: true}})
    assert_received 11
    refute_received 12
  end

  test "a missing assign is named" do
    assigns = %{a: 1}
    assert_raise KeyError, ~r/no assign @b; available: \[:a\]/, fn -> html(~H"{@b}") end
  end
end
